"""The lighthouse: find the right corner of a line or square of which one sees but a little.

The goal is in one corner, and shows when it comes into view. An expert who sees further than the
agent walks where the agent has no reason to walk, so that it cannot be imitated; how much further
is the size of the imitation gap.

Source: `lighthouse_plugin` of AllenAct, https://github.com/allenai/allenact, and its use in Weihs
et al. 2021, "Bridging the Imitation Gap by Adaptive Insubordination"
(https://arxiv.org/abs/2007.12173).
"""

from envs_jax.lighthouse.catalogue import lighthouse as lighthouse
from envs_jax.lighthouse.expert import optimal_length as optimal_length
from envs_jax.registry import register as _register

__all__ = ["lighthouse", "optimal_length"]

_register("Advisor-Lighthouse-v0", lighthouse)
