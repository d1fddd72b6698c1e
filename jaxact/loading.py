"""Finding an experiment by file, by dotted name, or by the name of a shipped example."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from jaxact.errors import JaxactError, unknown
from jaxact.experiment import Experiment

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def load_experiment(name: str) -> tuple[Experiment, Path]:
    """Loads the `experiment` that a Python file defines.

    Args:
      name: a file ("examples/babyai_gotolocal.py"), a dotted module name, or the name of a shipped
        example ("babyai_gotolocal").

    Returns:
      The experiment, and the file it was defined in.

    Raises:
      JaxactError: there is no such file, module or example, or it defines no experiment.
    """
    module, path = _load_module(name)
    experiment = getattr(module, "experiment", None)
    if not isinstance(experiment, Experiment):
        found = "nothing of that name" if experiment is None else f"a {type(experiment).__name__}"
        raise JaxactError(
            f"{path} must define `experiment`, a jaxact.Experiment, but it has {found}"
        )
    return experiment, path


def shipped_examples() -> list[str]:
    """Returns the names of the shipped examples."""
    return sorted(path.stem for path in EXAMPLES.glob("*.py") if path.stem != "__init__")


def _load_module(name: str) -> tuple[ModuleType, Path]:
    path = Path(name)
    if name.endswith(".py"):
        if not path.is_file():
            raise JaxactError(
                f"there is no file {name}; give a file, a dotted module name, or one of the "
                f"shipped examples ({', '.join(shipped_examples())})"
            )
        return _load_file(path), path
    if name in shipped_examples():
        return _load_file(EXAMPLES / f"{name}.py"), EXAMPLES / f"{name}.py"
    try:
        spec = importlib.util.find_spec(name) if "." in name else None
    except ModuleNotFoundError:
        spec = None
    if spec is None or spec.origin is None:
        raise unknown("experiment", name, shipped_examples())
    return importlib.import_module(name), Path(spec.origin)


def _load_file(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # The experiment's own directory comes first, as when Python runs a script.
    sys.path.insert(0, str(path.resolve().parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.pop(0)
    return module
