"""Grid worlds of several agents, each an object of the grid with a view of its own.

The rules, and the names of the two games, are those of A. Fickinger's gym-multigrid, 2020
(https://github.com/ArnaudFickinger/gym-multigrid, 77b0ee0); what is of our own making is said where
it is.
"""

from envs_jax.multigrid.environment import MultiGrid as MultiGrid
from envs_jax.multigrid.environment import MultiGridState as MultiGridState
from envs_jax.multigrid.games import MultiGridSampler as MultiGridSampler
from envs_jax.multigrid.games import collect as collect
from envs_jax.multigrid.games import soccer as soccer
from envs_jax.multigrid.points import Points as Points
from envs_jax.multigrid.sensors import MultiGridSensor as MultiGridSensor
from envs_jax.registry import register as _register

__all__ = [
    "MultiGrid",
    "MultiGridSampler",
    "MultiGridSensor",
    "MultiGridState",
    "Points",
    "collect",
    "soccer",
]

_register("MultiGrid-Soccer4HEnv10x15N2-v0", soccer)
_register("MultiGrid-Collect4HEnv10x10N2-v0", collect)
