"""Worlds of several agents in which given policies play some of them.

What is left is a world of fewer agents, or of one: `against` makes it. Since others act on what
they see, and what they see is the sensors' business, its environment is the whole game: the world,
its task and the opponents' memories. Task and sensors of the world that is left read there what
concerns the learners.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np

from jaxact.errors import JaxactError
from jaxact.game import Game, GameState, Opponent, rows_of, space_of
from jaxact.policy import Policy
from jaxact.pomdp import (
    POMDP,
    Episode,
    ExpertAction,
    FinishedEpisodes,
    FollowsPolicy,
    Listed,
    Outcome,
    Pictured,
    PyTree,
    Sensor,
    Task,
    TaskSampler,
)
from jaxact.spaces import Agents, Space


@dataclass(frozen=True)
class Judged(Task):
    """The task of the learners in a game; its state is that of the game's own task.

    Attributes:
      learners: the agents whose rewards they are.
    """

    learners: tuple[int, ...]

    def check(self, pomdp: POMDP) -> None:
        """Refuses what is no game, and samplers that cannot bring opponents' parameters."""
        game = pomdp.environment
        if not isinstance(game, Game):
            raise JaxactError(
                f"the task of a game cannot judge {type(game).__name__}: make the game of it with "
                "jaxact.opponents.against"
            )
        brought = any(opponent.policy.params is None for opponent in game.opponents)
        if brought and not isinstance(pomdp.sampler, FollowsPolicy):
            raise JaxactError(
                f"{type(pomdp.sampler).__name__} cannot be told of what the policy has learnt, as "
                "past selves need: wrap the world's own sampler in it, and make the game after that"
            )

    def step(
        self, task_state: PyTree, before: GameState, action: PyTree, after: GameState
    ) -> tuple[PyTree, Outcome]:
        """Returns what the game's task said of the step, and of the rewards the learners' own."""
        del task_state, before, action
        reward = {name: rows_of(x, self.learners) for name, x in after.outcome.reward.items()}
        return after.task, replace(after.outcome, reward=reward)


@dataclass(frozen=True)
class Demonstrated(Judged):
    """The same where the game's task has an expert.

    Attributes:
      task: of the game.
    """

    task: Task

    def expert(self, key: jax.Array, task_state: PyTree, state: GameState) -> ExpertAction:
        """Returns its advice to the learners."""
        advice = self.task.expert(key, task_state, state.environment)  # type: ignore[attr-defined]
        return rows_of(advice, self.learners)


@dataclass(frozen=True)
class Seen(Sensor):
    """What the learners in a game see of a sensor.

    Attributes:
      sensor: of the world.
      name: its name there.
      learners: the agents whose readings they are.
    """

    sensor: Sensor
    name: str
    learners: tuple[int, ...]

    @property
    def space(self) -> Space:
        """That of the sensor, for each learner; without an axis if there is one."""
        return space_of(self.sensor.space, self.learners)

    def observe(self, state: GameState, task_state: PyTree) -> jax.Array:
        """Returns their readings."""
        del task_state
        return rows_of(state.readings[self.name], self.learners)


@dataclass(frozen=True)
class SeenPicture(Seen):
    """The same of a sensor that can be pictured."""

    def picture(self, state: GameState, task_state: PyTree) -> jax.Array:
        """Returns the sensor's own frame."""
        return self.sensor.picture(state.environment, task_state)  # type: ignore[attr-defined]


@dataclass(frozen=True)
class WithOpponents(TaskSampler):
    """Draws the episodes of a game: those of its world.

    Attributes:
      game: whose world has the sampler.
    """

    game: Game = field(repr=False)

    @property
    def learns(self) -> bool:
        """Whether the world's sampler does."""
        return self.game.pomdp.sampler.learns

    @property
    def held_out(self) -> TaskSampler:
        """The same for the world's held-out episodes."""
        world = self.game.pomdp
        return replace(
            self, game=replace(self.game, pomdp=replace(world, sampler=world.sampler.held_out))
        )

    def init(self, key: jax.Array) -> PyTree:
        """Returns the first state of the world's sampler."""
        return self.game.pomdp.sampler.init(key)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode of the world."""
        episode = self.game.pomdp.sampler.sample(key, sampler_state)
        brought = ((),) * len(self.game.opponents)
        return replace(episode, environment=self.game.begin(episode, brought))

    def update(self, sampler_state: PyTree, finished: FinishedEpisodes) -> PyTree:
        """Lets the world's sampler learn."""
        return self.game.pomdp.sampler.update(sampler_state, finished)

    def kinds(self, origin: PyTree) -> Mapping[str, jax.Array]:
        """Those of the world's sampler."""
        return self.game.pomdp.sampler.kinds(origin)

    def metrics(self, sampler_state: PyTree) -> Mapping[str, jax.Array]:
        """Those of the world's sampler."""
        return self.game.pomdp.sampler.metrics(sampler_state)


def against(
    pomdp: POMDP, policies: Mapping[int | tuple[int, ...], Policy], *, greedy: bool = False
) -> POMDP:
    """Makes of a world of several agents one of those that no given policy plays.

    If one is left, the world is one of a single agent, without an axis of agents, and all that is
    for such worlds can be had. What the world's parts are set to is found under
    `environment.pomdp` of what is made.

    Args:
      pomdp: the world.
      policies: who plays which agent or agents, for example what `jaxact.evaluate.load_policy` read
        from a run. A policy is one of these agents, or one of all agents of the world, of whose
        actions only theirs are taken. It is frozen: compiled in as it stands.
      greedy: whether they take their most likely actions instead of samples.

    Returns:
      The world that is left to the learners.

    Raises:
      JaxactError: the world is one of a single agent, agents are not there, are played twice or all
        of them, or a policy is another world's.
    """
    opponents = []
    for key, policy in policies.items():
        agents = (key,) if isinstance(key, int) else tuple(key)
        # On the host, so that programs on any device can take them in.
        frozen = replace(policy, params=jax.tree.map(np.asarray, policy.params))
        opponents.append(Opponent(agents, frozen, greedy))
    game = make_game(pomdp, opponents)
    for opponent in opponents:
        _check_policy(game, opponent)
    return world_of(game, WithOpponents(game))


def make_game(pomdp: POMDP, opponents: Sequence[Opponent]) -> Game:
    """Returns the game.

    Raises:
      JaxactError: see `against`.
    """
    if not isinstance(pomdp.action_space, Agents):
        raise JaxactError(
            "opponents are for worlds of several agents, and this one has one without an axis of "
            "agents"
        )
    if isinstance(pomdp.sampler.held_out, Listed):
        raise JaxactError("opponents are for worlds whose held-out episodes are not listed")
    count = pomdp.num_agents
    taken = [agent for opponent in opponents for agent in opponent.agents]
    for agent in taken:
        if not 0 <= agent < count:
            raise JaxactError(f"there is no agent {agent}: they are 0 to {count - 1}")
        if taken.count(agent) > 1:
            raise JaxactError(f"agent {agent} is played by two policies; give it to one of them")
    if len(taken) == count:
        raise JaxactError(f"all {count} agents are played by given policies: leave one to learn")
    return Game(pomdp, tuple(opponents))


def world_of(game: Game, sampler: TaskSampler) -> POMDP:
    """Returns the world that a game is to its learners."""
    world, learners = game.pomdp, game.learners
    task = Demonstrated(learners, world.task) if world.has_expert else Judged(learners)
    sensors = {
        name: (SeenPicture if isinstance(sensor, Pictured) else Seen)(sensor, name, learners)
        for name, sensor in world.sensors.items()
    }
    return POMDP(game, task, sampler, sensors)


def _check_policy(game: Game, opponent: Opponent) -> None:
    """Refuses a policy that cannot play these agents."""
    world, policy, agents = game.pomdp, opponent.policy, opponent.agents
    own = space_of(world.action_space, agents)
    who = f"the policy for agent(s) {', '.join(map(str, agents))}"
    if policy.action_space not in (own, world.action_space):
        raise JaxactError(
            f"{who} must choose from {own}, or from {world.action_space} for all agents, but it "
            f"chooses from {policy.action_space}"
        )
    shapes = world.observation_space.structure
    if policy.action_space == own:
        shapes = jax.eval_shape(lambda x: rows_of(x, agents), shapes)
    try:
        jax.eval_shape(policy.output, shapes, policy.initial_memory())
    except Exception as error:
        seen = ", ".join(f"{name} {x.dtype}{list(x.shape)}" for name, x in shapes.items())
        raise JaxactError(f"{who} cannot read what they see, {seen}: {error}") from error
