"""Houses, maps and episodes, read from files and written to them."""
