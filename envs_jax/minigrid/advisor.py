"""The grid worlds of ADVISOR's experiments: a table of ids, without the prefix `Advisor-`.

Source: Weihs et al. 2021, "Bridging the Imitation Gap by Adaptive Insubordination"
(https://arxiv.org/abs/2007.12173), and `minigrid_and_pd_experiments/base.py` of its repository,
https://github.com/allenai/advisor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from envs_jax.minigrid.ask_for_help import (
    AskForHelpSampler,
    AskForHelpTask,
    AskForHelpWorld,
    LitSensor,
)
from envs_jax.minigrid.catalogue import compose
from envs_jax.minigrid.corruption import corrupt_expert
from envs_jax.minigrid.environment import GridWorld
from envs_jax.minigrid.samplers.crossing import CrossingSampler
from envs_jax.minigrid.sensors import VIEW_SIZE, GridSensor
from envs_jax.minigrid.tasks import GoalTask
from envs_jax.minigrid.views import TILE_SIZE
from envs_jax.registry import register
from jaxact.pomdp import POMDP
from jaxact.spaces import Discrete

# Size, rivers, and whether they are of wall.
_CROSSINGS = {
    "LavaCrossingS15N7-v0": (15, 7, False),
    "LavaCrossingS25N10-v0": (25, 10, False),
    "WallCrossingS25N10-v0": (25, 10, True),
}
# Which crossing, and within how many actions of the goal the expert is of no use. The experiments'
# numbers are 10 and 15, which count one more, see `CorruptGoalTask`.
_CORRUPT = {
    "LavaCrossingCorruptExpertS15N7-v0": ("LavaCrossingS15N7-v0", 9),
    "WallCrossingCorruptExpertS25N10-v0": ("WallCrossingS25N10-v0", 14),
}
# Size, rivers, whether they are of wall, and whether the light, once put on, stays on.
_ASK_FOR_HELP = {
    "AskForHelpSimpleCrossing-v0": (15, 7, True, False),
    "AskForHelpSimpleCrossingOnce-v0": (25, 10, True, True),
    "AskForHelpLavaCrossingOnce-v0": (15, 7, False, True),
    "AskForHelpLavaCrossingSmall-v0": (9, 4, False, False),
}


@dataclass(frozen=True)
class CrossingWorld(GridWorld):
    """`GridWorld` with the actions that a crossing needs: left, right and forward."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """Left, right, forward."""
        return ("left", "right", "forward")

    @property
    def action_space(self) -> Discrete:
        """Three actions."""
        return Discrete(3)


def _crossing(
    size: int,
    rivers: int,
    walls: bool,
    corrupt_within: int | None = None,
    observation: str = "image",
    view_size: int = VIEW_SIZE,
    tile_size: int = TILE_SIZE,
) -> POMDP:
    """Builds a crossing, whose expert is corrupt if `corrupt_within` says near what."""
    pomdp = compose(
        GoalTask(size, size),
        CrossingSampler(size, rivers, 4 * size**2, walls),
        size,
        size,
        environment=CrossingWorld(size, size),
        observation=observation,
        view_size=view_size,
        tile_size=tile_size,
    )
    return pomdp if corrupt_within is None else corrupt_expert(pomdp, corrupt_within)


def _ask_for_help(
    size: int,
    rivers: int,
    walls: bool,
    toggle_is_permanent: bool,
    observation: str = "image",
    view_size: int = VIEW_SIZE,
    tile_size: int = TILE_SIZE,
    exploration_reward: float = 0.0,
    death_penalty: float = 0.0,
) -> POMDP:
    """Builds a crossing in the dark."""
    pomdp = _crossing(size, rivers, walls, None, observation, view_size, tile_size)
    image = pomdp.sensors["image"]
    assert isinstance(image, GridSensor)
    return replace(
        pomdp,
        environment=AskForHelpWorld(size, size, toggle_is_permanent),
        task=AskForHelpTask(
            size, size, exploration_reward=exploration_reward, death_penalty=death_penalty
        ),
        sampler=AskForHelpSampler(pomdp.sampler, size, size),
        sensors={**pomdp.sensors, "image": LitSensor(image)},
    )


def register_all() -> None:
    """Registers them. All take the options of other grid worlds.

    Crossings also take `corrupt_within`, see `corrupt_expert`; those in which the agent asks for
    help take `exploration_reward` and `death_penalty` instead, see `AskForHelpTask`.
    """
    for name, row in _CROSSINGS.items():
        register(f"Advisor-{name}", partial(_crossing, *row))
    for name, (crossing, within) in _CORRUPT.items():
        builder = partial(_crossing, *_CROSSINGS[crossing], corrupt_within=within)
        register(f"Advisor-{name}", builder)
    for name, switch_row in _ASK_FOR_HELP.items():
        register(f"Advisor-{name}", partial(_ask_for_help, *switch_row))
