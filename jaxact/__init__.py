"""jaxact: embodied-AI research in JAX.

Environment, task, task sampler, sensors, model, losses and training pipeline are separate parts;
an `Experiment` puts them together and `train` compiles it.
"""

from jaxact.errors import JaxactError as JaxactError
from jaxact.pomdp import POMDP as POMDP

# Everything else loads when it is first asked for, so that `import jaxact` stays quick.
_LAZY = {
    "Experiment": "experiment",
    "Stage": "pipeline",
    "TrainingPipeline": "pipeline",
    "EarlyStopping": "pipeline",
    "Policy": "policy",
    "make_train": "program",
    "make_key": "train_state",
    "evaluate_policy": "evaluation",
    "evaluate_expert": "evaluation",
    "override": "overrides",
    "sweep": "sweep",
    "train": "train",
}
_SUBMODULES = ("losses", "models", "samplers", "schedules", "spaces", "testing")

__all__ = ["POMDP", "JaxactError", *_LAZY, *_SUBMODULES]


def __getattr__(name: str) -> object:
    import importlib

    if name in _SUBMODULES:
        return importlib.import_module(f"jaxact.{name}")
    if name in _LAZY:
        module = importlib.import_module(f"jaxact.{_LAZY[name]}")
        return getattr(module, name)
    raise AttributeError(f"module 'jaxact' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
