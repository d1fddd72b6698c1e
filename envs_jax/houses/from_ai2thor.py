"""PointNav and ObjectNav in AI2-THOR's own simulator, judged as in the houses in JAX.

Actions, rewards, success and metrics bear the same names and are of the same presets, so that an
experiment in houses in JAX is one in AI2-THOR when its world is exchanged. The simulator is outside
of JAX: see `jaxact.from_gymnasium` for what that means.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from envs_jax.houses import metrics, presets
from envs_jax.houses.categories import ROBOTHOR_TARGETS
from envs_jax.houses.importers.episodes import NavigationEpisode
from envs_jax.houses.object_nav import ObjectNav
from envs_jax.houses.point_nav import PointNav
from envs_jax.houses.sensors import point_goal
from envs_jax.houses.thor_simulator import METRICS, Controller, Walks, make_simulator
from envs_jax.houses.vision import ALLENACT_DEPTH, DepthScale
from jaxact.errors import JaxactError, unknown
from jaxact.from_gymnasium import from_gymnasium
from jaxact.pomdp import POMDP, Outcome, PyTree, Sensor, Task
from jaxact.simulated import SimulatedState
from jaxact.spaces import Box

PLATFORMS = ("robothor", "ithor")
TASKS = ("point_nav", "object_nav")
HORIZON = 500


def from_ai2thor(
    platform: str = "robothor",
    task: str = "point_nav",
    *,
    scenes: Sequence[str] = (),
    held_out_scenes: Sequence[str] = (),
    episodes: Sequence[NavigationEpisode] = (),
    held_out_episodes: Sequence[NavigationEpisode] = (),
    targets: Sequence[str] = ROBOTHOR_TARGETS,
    observation: Sequence[str] = ("depth",),
    width: int = 400,
    height: int = 300,
    simulators: int = 1,
    threads: int = 0,
    make_controller: Callable[..., Controller] | None = None,
    **settings: Any,
) -> POMDP:
    """Makes a world of AI2-THOR's controllers, which are processes of their own.

    Args:
      platform: "robothor" or "ithor", whose actions, rewards and rules of success these are.
      task: "point_nav" or "object_nav".
      scenes: names of scenes in which starts and goals are drawn to train on, for example
        "FloorPlan_Train1_1".
      held_out_scenes: the same for evaluation; those for training if there are none.
      episodes: to train on in place of `scenes`, see `importers.robothor.read_episodes`.
      held_out_episodes: for evaluation, each played once and in order.
      targets: object types of "object_nav".
      observation: views, out of "rgb" and "depth" (AllenAct's scale), beside "point_goal" (distance
        and bearing) or "object_goal" (the target's number).
      width, height: pixels of a view.
      simulators: how many controllers there can be, at least as many as lanes; as many are for
        evaluation.
      threads: how many of them are waited for at once.
      make_controller: in place of `ai2thor.controller.Controller`.
      **settings: its other arguments.

    Returns:
      The POMDP; one controller is started at once, and one for evaluation if that is elsewhere; the
      others when they are needed.

    Raises:
      JaxactError: no such platform, task or view, or AI2-THOR is not installed.
    """
    if platform not in PLATFORMS:
        raise unknown("platform", platform, PLATFORMS)
    names = {"scenes": scenes, "held_out_scenes": held_out_scenes, "targets": targets}
    for name, given in (names | {"observation": observation}).items():
        if isinstance(given, str):
            raise JaxactError(f"{name} is a sequence of names, as ({given!r},)")
    if task not in TASKS:
        raise unknown("task", task, TASKS)
    finds = task == "object_nav"
    judge = presets.object_nav(platform) if finds else presets.point_nav(platform)
    house = judge.house
    walks = Walks(
        actions=house.actions,
        episodes=tuple(episodes),
        scenes=tuple(scenes),
        targets=tuple(targets) if finds else (),
        step_size=house.step_size,
        turn=house.turn,
        look=house.look,
        pitch=30.0 if finds else 0.0,
    )
    make = functools.partial(
        make_simulator,
        make_controller,
        _settings(platform, judge, observation, width, height, settings),
        views=tuple(observation),
    )
    others = None
    if held_out_episodes:
        others = replace(walks, episodes=tuple(held_out_episodes), scenes=())
    elif held_out_scenes:
        others = replace(walks, episodes=(), scenes=tuple(held_out_scenes))
    pomdp = from_gymnasium(
        functools.partial(make, walks=walks),
        simulators=simulators,
        threads=threads,
        horizon=HORIZON,
        metrics=METRICS,
        task=ThorNavigation(judge),
        action_names=house.actions,
        held_out=None if others is None else functools.partial(make, walks=others),
        held_out_seeds=len(held_out_episodes),
    )
    sensors: dict[str, Sensor] = dict(pomdp.sensors)
    del sensors["place"]
    goal = sensors.pop("goal")
    sensors |= {"object_goal": goal} if finds else {"point_goal": ThorPointGoal()}
    if "depth" in sensors:
        sensors["depth"] = ThorDepth(height, width)
    return replace(pomdp, sensors=sensors)


def _settings(
    platform: str,
    judge: PointNav | ObjectNav,
    observation: Sequence[str],
    width: int,
    height: int,
    others: dict[str, Any],
) -> dict[str, Any]:
    """Returns the controller's arguments."""
    across = {"robothor": 79.0, "ithor": 90.0}[platform]
    mode = {"robothor": "locobot", "ithor": "default"}[platform]
    sight = judge.sight if isinstance(judge, ObjectNav) else presets.object_nav(platform).sight
    down = 2 * math.degrees(math.atan(math.tan(math.radians(across) / 2) * height / width))
    return {
        "agentMode": mode,
        "gridSize": judge.house.step_size,
        "rotateStepDegrees": judge.house.turn,
        "snapToGrid": False,
        "visibilityDistance": sight.distance,
        "fieldOfView": down,
        "width": width,
        "height": height,
        "renderDepthImage": "depth" in observation,
        **others,
    }


@dataclass(frozen=True)
class ThorNavigation(Task):
    """PointNav or ObjectNav on what AI2-THOR says.

    Success of ObjectNav is the simulator's own "visible". The names and numbers are those of the
    task in houses in JAX.

    Attributes:
      judge: that task, with its rewards and radius.
    """

    judge: PointNav | ObjectNav

    def __post_init__(self) -> None:
        if isinstance(self.judge, ObjectNav) and self.judge.rule != "visible":
            raise JaxactError(f"AI2-THOR's rule of success is 'visible', not {self.judge.rule!r}")

    def step(
        self, task_state: PyTree, before: SimulatedState, action: PyTree, after: SimulatedState
    ) -> tuple[PyTree, Outcome]:
        """Judges one step; see `Task.step`."""
        said, judge = after.metrics, self.judge
        ended = jnp.asarray(action, jnp.int32) == judge.house.actions.index("end")
        success = ended & self._reached(said)
        approach = before.metrics["distance_to_goal"] - said["distance_to_goal"]
        zero = jnp.float32(0)
        reward = {"step": self._number("step_penalty")}
        if isinstance(judge, ObjectNav):
            approach = jnp.clip(approach, -said["moved"], said["moved"])
            penalty = self._number("refusal_penalty")
            reward["refusal"] = jnp.where(said["refused"] > 0, penalty, zero)
        end_reward = jnp.where(
            success, self._number("success_reward"), self._number("failure_reward")
        )
        reward["shaping"] = self._number("shaping") * approach
        reward["success"] = jnp.where(ended, end_reward, zero)
        left, shortest, walked = (
            said[name] for name in ("distance_to_goal", "shortest", "path_length")
        )
        return task_state, Outcome(
            reward=reward,
            success={"goal": success},
            terminated=after.terminated,
            metrics={
                "spl": metrics.spl(success, shortest, walked),
                "soft_spl": metrics.soft_spl(left, shortest, walked),
                "distance_to_goal": left,
                "path_length": walked,
            },
            truncated=after.truncated,
        )

    def _reached(self, said: dict[str, jax.Array]) -> jax.Array:
        """Returns a bool scalar: whether to end here is success."""
        if isinstance(self.judge, ObjectNav):
            return said["visible"] > 0
        distance, radius = said["distance_to_goal"], self._number("radius")
        return distance < radius if self.judge.strict else distance <= radius

    def _number(self, name: str) -> jax.Array:
        return jnp.asarray(getattr(self.judge, name), jnp.float32)


@dataclass(frozen=True)
class ThorPointGoal(Sensor):
    """The goal's distance in metres and its bearing in radians, positive to the left."""

    @property
    def space(self) -> Box:
        """Two numbers without bounds."""
        return Box(-math.inf, math.inf, (2,))

    def observe(self, state: SimulatedState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        place = state.observation["place"]
        return point_goal("allenact", place[:2], place[2], state.observation["goal"])


@dataclass(frozen=True)
class ThorDepth(Sensor):
    """Depths on AllenAct's scale, float32 [H, W, 1].

    Attributes:
      height, width: pixels.
      scale: how metres become readings.
    """

    height: int
    width: int
    scale: DepthScale = ALLENACT_DEPTH

    @property
    def space(self) -> Box:
        """Scaled depths."""
        return self.scale.space(self.height, self.width)

    def observe(self, state: SimulatedState, task_state: PyTree) -> jax.Array:
        """Returns the depths."""
        del task_state
        return self.scale.apply(state.observation["depth"])
