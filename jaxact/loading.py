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
    """Loads the `experiment` that a Python file defines, or one of its `experiments`.

    Args:
      name: a file ("examples/babyai_gotolocal.py"), a dotted module name, or the name of a shipped
        example ("babyai_gotolocal"); with a colon and a key behind it, an entry of the mapping
        `experiments` in that file ("examples/advisor.py:poisoned_doors_ppo").

    Returns:
      The experiment, and the file it was defined in.

    Raises:
      JaxactError: there is no such file, module or example, or it defines no such experiment.
    """
    file, variant = split_variant(name)
    module, path = _load_module(file)
    if variant:
        experiments = getattr(module, "experiments", {})
        if variant not in experiments:
            raise unknown(f"entry of `experiments` in {path}", variant, experiments)
        experiment = experiments[variant]
    else:
        experiment = getattr(module, "experiment", None)
    if not isinstance(experiment, Experiment):
        found = "nothing of that name" if experiment is None else f"a {type(experiment).__name__}"
        raise JaxactError(
            f"{path} must define `experiment`, a jaxact.Experiment, but it has {found}"
        )
    return experiment, path


def split_variant(name: str) -> tuple[str, str]:
    """Splits "file.py:key" into the file and the key, which is empty where there is none.

    >>> split_variant("examples/advisor.py:poisoned_doors_ppo")
    ('examples/advisor.py', 'poisoned_doors_ppo')
    """
    file, colon, variant = name.rpartition(":")
    # A path of Windows has a colon behind the drive's letter.
    return (file, variant) if colon and variant.isidentifier() else (name, "")


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
    # Where dataclasses look up annotations that are strings.
    sys.modules.setdefault(path.stem, module)
    # The experiment's own directory comes first, as when Python runs a script.
    sys.path.insert(0, str(path.resolve().parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.pop(0)
    return module
