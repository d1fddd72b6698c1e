"""Others' houses, maps and episodes, read from their files."""
