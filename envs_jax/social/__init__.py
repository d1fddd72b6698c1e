"""Small worlds of several agents in which it pays to act together, and costs to try alone.

Stag Hunt, Harvest and Escalation on a grid, after A. Peysakhovich and A. Lerer, "Prosocial learning
agents solve generalized Stag Hunts better than selfish ones" (https://arxiv.org/abs/1709.02865), as
https://github.com/NullDefault/Gym-Stag-Hunt has them.
"""

from envs_jax.registry import register as _register
from envs_jax.social.escalation import Escalation as Escalation
from envs_jax.social.escalation import Streak as Streak
from envs_jax.social.escalation import escalation as escalation
from envs_jax.social.harvest import Harvest as Harvest
from envs_jax.social.harvest import Reap as Reap
from envs_jax.social.harvest import harvest as harvest
from envs_jax.social.stag_hunt import Hunt as Hunt
from envs_jax.social.stag_hunt import StagHunt as StagHunt
from envs_jax.social.stag_hunt import stag_hunt as stag_hunt

__all__ = [
    "Escalation",
    "Harvest",
    "Hunt",
    "Reap",
    "StagHunt",
    "Streak",
    "escalation",
    "harvest",
    "stag_hunt",
]

_register("Markov-StagHunt-v0", stag_hunt)
_register("Markov-Harvest-v0", harvest)
_register("Markov-Escalation-v0", escalation)
