"""The quickstart notebook runs from top to bottom."""

import os
from pathlib import Path

import nbformat
import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
NOTEBOOK = REPOSITORY / "examples" / "quickstart.ipynb"
# Training takes too long for every day: the same cells with fewer steps and episodes.
SHORTER = {
    "steps=40_000": "steps=1_024",
    "steps=20_000": "steps=1_024",
    "steps=16_384": "steps=2_048",
    "evaluation_episodes=500": "evaluation_episodes=50",
    "evaluate_expert(pomdp, 500)": "evaluate_expert(pomdp, 50)",
    "evaluate_policy(pomdp, policy, 500)": "evaluate_policy(pomdp, policy, 50)",
}


def test_stored_without_outputs():
    for cell in nbformat.read(NOTEBOOK, as_version=4).cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


def shorten(notebook):
    """Puts fewer steps and episodes into its code."""
    found = set()
    for cell in notebook.cells:
        for long, short in SHORTER.items():
            if long in cell.source:
                found.add(long)
                cell.source = cell.source.replace(long, short)
    assert found == set(SHORTER)


# Jupyter's own packages warn of one another's plans and leave sockets to the garbage collector.
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("shortened", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_runs(shortened, monkeypatch):
    from nbclient import NotebookClient

    paths = [str(REPOSITORY), os.environ.get("PYTHONPATH")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in paths if path))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    if shortened:
        shorten(notebook)
    else:
        # Without the tests' own flags, which make training crawl.
        monkeypatch.delenv("XLA_FLAGS", raising=False)
    resources = {"metadata": {"path": str(NOTEBOOK.parent)}}
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()

    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    text = "".join(output.text for output in outputs if output.output_type == "stream")
    assert "the same episodes, the same actions: True" in text
    kinds = [kind for output in outputs for kind in output.get("data", {})]
    assert kinds.count("image/png") == 3
    assert "image/gif" in kinds
