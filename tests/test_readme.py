"""The README's Python code runs as it stands, block after block, in one session."""

import os
import re
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
README = REPOSITORY / "README.md"


def code_of(text):
    """Returns the Python blocks as one program with the README's own line numbers."""
    lines, inside = [], False
    for line in text.splitlines():
        if line.startswith("```"):
            inside = line == "```python"
            line = ""
        lines.append(line if inside else "")
    return "\n".join(lines)


def test_code_of_the_readme_runs(tmp_path):
    text = README.read_text(encoding="utf-8")
    assert len(re.findall(r"^```python$", text, re.M)) == 9
    program = tmp_path / "README.py"
    program.write_text(code_of(text), encoding="utf-8")
    # Without the tests' own flags, which make training crawl.
    environment = os.environ | {"XLA_FLAGS": "", "PYTHONPATH": str(REPOSITORY)}
    finished = subprocess.run(
        [sys.executable, str(program)],
        cwd=tmp_path,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    *_, success, action, position, sweep = finished.stdout.splitlines()
    assert float(re.search(r"'mean': ([\d.]+)", success)[1]) > 0.5
    assert action in ("left", "right", "forward", "pickup", "drop", "toggle", "done")
    assert position.startswith("[")
    assert sweep == "(2, 3)"
