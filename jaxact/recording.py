"""Films of episodes: what the sensors show, and the way that was taken where there is a chart, with
mission, policy and value beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxact.caching import cached_by_identity
from jaxact.distributions import Categorical, Distribution
from jaxact.errors import JaxactError
from jaxact.evaluation import begin_held_out, held_out_lanes
from jaxact.features import check_names, draw, intermediates
from jaxact.policy import Policy, PolicyMemory
from jaxact.pomdp import POMDP, Charted
from jaxact.simulators import explained
from jaxact.spaces import Space
from jaxact.video import annotate


@explained()
def record_episode(
    pomdp: POMDP,
    policy: Policy,
    *,
    seed: int = 0,
    greedy: bool = False,
    max_steps: int = 200,
    features: Sequence[str] = (),
) -> np.ndarray:
    """Films the first held-out episode of a seed, step for step as evaluation plays it.

    Of several agents, value and reward are the means.

    Args:
      pomdp: the world; a sensor must be `Pictured`, or the environment `Charted`.
      policy: who plays.
      seed: of the held-out episodes.
      greedy: whether the most likely actions are taken.
      max_steps: the film ends after so many steps.
      features: names of the model's intermediates to be shown, as `features.intermediates` has
        them.

    Returns:
      uint8 [T, H, W, 3], at least one frame.

    Raises:
      JaxactError: no sensor can be pictured, or the model has no such intermediate.
    """
    check_names(pomdp, policy, features)
    inside = _intermediates(policy.model, pomdp.action_space) if features else None
    start, advance, show = _player(pomdp, policy.model, greedy)
    trail = np.full((max_steps, 2), np.nan, np.float32)
    beginnings, step_keys = held_out_lanes(pomdp, seed, 1)
    state, observation, memory = start(beginnings[0])
    mission = pomdp.words(observation) or None
    total, frames = 0.0, []
    for t in range(max_steps):
        key = jax.random.fold_in(step_keys[0], t)
        shown, trail = show(state, trail, t)
        pictures = list(jax.device_get(shown).values())
        if inside is not None:
            found = jax.device_get(inside(policy.params, observation, memory))
            pictures += [draw(found[name]) for name in features]
        state, observation, memory, step, action, output = advance(
            policy.params, key, state, observation, memory
        )
        reward = float(np.mean(step.reward))
        total += reward
        bars = _bars(pomdp, output.distribution, np.asarray(action))
        frames.append(
            annotate(
                side_by_side(pictures),
                **bars,
                value=float(np.mean(output.value)),
                reward=reward,
                episode_return=total,
                step=t,
                mission=mission,
            )
        )
        if step.finished:
            break
    return np.stack(frames)


def _bars(pomdp: POMDP, distribution: Distribution, action: np.ndarray) -> dict[str, Any]:
    """Returns the names and probabilities of discrete actions, and which were taken; of all agents
    where there are several.
    """
    names = pomdp.environment.action_names
    if not isinstance(distribution, Categorical) or not names:
        return {"action_names": (), "action_probabilities": (), "chosen": ()}
    probabilities = np.asarray(distribution.probabilities).reshape(-1)
    agents = len(probabilities) // len(names)
    return {
        "action_names": names
        if agents == 1
        else [f"{i}: {n}" for i in range(agents) for n in names],
        "action_probabilities": probabilities,
        "chosen": [i * len(names) + int(a) for i, a in enumerate(action.reshape(-1))],
    }


def side_by_side(pictures: list[np.ndarray]) -> np.ndarray:
    """Puts pictures uint8 [H, W, 3] next to each other, centred on black.

    Raises:
      JaxactError: there are none.
    """
    if not pictures:
        raise JaxactError(
            "there is nothing to film: no sensor has a method picture(state, task_state)"
        )
    height = max(picture.shape[0] for picture in pictures)

    def centred(picture: np.ndarray) -> np.ndarray:
        spare = height - picture.shape[0]
        return np.pad(picture, ((spare // 2, spare - spare // 2), (0, 0), (0, 0)))

    gap = np.zeros((height, 8, 3), np.uint8)
    row = [centred(pictures[0])]
    for picture in pictures[1:]:
        row += [gap, centred(picture)]
    return np.concatenate(row, axis=1)


@cached_by_identity
def _player(pomdp: POMDP, model: Any, greedy: bool) -> tuple[Any, Any, Any]:
    """Compiles the start of an episode, a step of it and its pictures."""

    def start(beginning: jax.Array) -> tuple[Any, ...]:
        state, observation = begin_held_out(pomdp, beginning)
        return state, observation, Policy(model, (), pomdp.action_space).initial_memory()

    def advance(
        params: Any, key: jax.Array, state: Any, observation: Any, memory: PolicyMemory
    ) -> tuple[Any, ...]:
        policy = Policy(model, params, pomdp.action_space)
        act_key, world_key = jax.random.split(key)
        output, _ = policy.output(observation, memory)
        action, memory = policy.act(act_key, observation, memory, greedy)
        state, step = pomdp.step(world_key, state, action)
        return state, step.observation, memory, step, action, output

    def show(state: Any, trail: jax.Array, t: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
        if isinstance(pomdp.environment, Charted):
            trail = trail.at[t].set(pomdp.environment.waypoint(state.environment))
        return pomdp.pictures(state, trail), trail

    return jax.jit(start), jax.jit(advance), jax.jit(show)


@cached_by_identity
def _intermediates(model: Any, action_space: Space) -> Any:
    """Compiles what a model computes on the way to its output."""

    def compute(params: Any, observation: Any, memory: PolicyMemory) -> dict[str, jax.Array]:
        return intermediates(Policy(model, params, action_space), observation, memory)

    return jax.jit(compute)
