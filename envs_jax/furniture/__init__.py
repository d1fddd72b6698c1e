"""Grid twins of tasks that two agents can only do together: to lift and to carry furniture.

FurnLift is of U. Jain et al., "Two Body Problem: Collaborative Visual Task Completion", 2019
(https://arxiv.org/abs/1904.05879), FurnMove of U. Jain et al., "A Cordial Sync: Going Beyond
Marginal Policies for Multi-Agent Embodied Tasks", 2020 (https://arxiv.org/abs/2007.04979). The
rules are those of the latter's code, whose FurnMove has a grid world beside the one in AI2-THOR.
Rooms are drawn or read, and where agents stand around the television (within 0.76 m of a cell that
it covers) is of our own making, as the original takes it from the simulator.
"""

from envs_jax.furniture.furn_lift import FurnLift as FurnLift
from envs_jax.furniture.furn_lift import Lift as Lift
from envs_jax.furniture.furn_lift import furn_lift as furn_lift
from envs_jax.furniture.furn_move import Carry as Carry
from envs_jax.furniture.furn_move import FurnMove as FurnMove
from envs_jax.furniture.furn_move import furn_move as furn_move
from envs_jax.furniture.rooms import DrawnRooms as DrawnRooms
from envs_jax.furniture.rooms import WrittenRooms as WrittenRooms
from envs_jax.furniture.rooms import read_map as read_map
from envs_jax.registry import register as _register

__all__ = [
    "Carry",
    "DrawnRooms",
    "FurnLift",
    "FurnMove",
    "Lift",
    "WrittenRooms",
    "furn_lift",
    "furn_move",
    "read_map",
]

_register("FurnMove-v0", furn_move)
_register("FurnLift-v0", furn_lift)
