"""Losses that cannot work where they stand, found before anything compiles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import jax

from jaxact.errors import JaxactError, unknown
from jaxact.losses.advisor import Advisor, AdvisorImitation
from jaxact.losses.base import Loss
from jaxact.losses.cordial import Cordial
from jaxact.losses.dqn import DQN
from jaxact.losses.fusion_entropy import FusionEntropy
from jaxact.losses.gail import GAIL
from jaxact.losses.pqn import PQN
from jaxact.losses.sac import SAC
from jaxact.models.output import ActorCriticOutput
from jaxact.pipeline import Stage, TrainingPipeline
from jaxact.spaces import Agents, Space
from jaxact.storages.base import Storage
from jaxact.team_distributions import joint_log_probs

# Losses that work on what `AgentsActorCritic` has not.
_OF_ONE_AGENT = (DQN, PQN, SAC, Advisor, AdvisorImitation, FusionEntropy)


@dataclass(frozen=True)
class _Use:
    """A loss where it stands: `length` are the steps of the sequences that it is given."""

    where: str
    name: str
    loss: Loss
    length: int

    def refuse(self, why: object) -> JaxactError:
        return JaxactError(f"{self.where}: loss {self.name!r}: {why}")


def check_losses(
    pipeline: TrainingPipeline,
    action_space: Space,
    output: ActorCriticOutput,
    observation: Any,
    action: Any,
) -> None:
    """Finds losses that learn nothing, or something else than they seem to, where they stand.

    Args:
      pipeline: what to learn.
      action_space: the world's.
      output: of the model on one lane, with shapes and dtypes in place of arrays.
      observation: of one lane, likewise.
      action: of one lane, likewise.

    Raises:
      JaxactError: a loss lacks something of the model, of the sequences that it is given, or of
        another loss that it works with; or shares a name, and so variables, with one that is
        different.
    """
    uses = list(_uses(pipeline))
    for use in uses:
        _check_use(use, action_space, output)
        if isinstance(use.loss, Cordial):
            _check_cordial(use, use.loss, action_space, output, observation)
    _check_shared(uses, output, observation, action)
    for index, stage in enumerate(pipeline.stages):
        _check_gail(f"stage {index}", stage)
        for name, storage in stage.storages.items():
            _check_priorities(f"stage {index}: storage {name!r}", storage)
    _check_forcing(pipeline)


def _uses(pipeline: TrainingPipeline) -> Iterator[_Use]:
    for index, stage in enumerate(pipeline.stages):
        where, length = f"stage {index}", pipeline.at(stage).rollout_length
        groups: list[tuple[str, Mapping[str, Loss], int]] = [(where, stage.losses, length)]
        for name, storage in stage.storages.items():
            groups.append((f"{where}: storage {name!r}", storage.losses, storage.length))
        for place, losses, steps in groups:
            yield from (_Use(place, name, loss, steps) for name, loss in losses.items())


def _check_use(use: _Use, action_space: Space, output: ActorCriticOutput) -> None:
    loss, kind = use.loss, type(use.loss).__name__
    # To losses agents are lanes side by side.
    own, whose = action_space, "the world's"
    if isinstance(action_space, Agents):
        own, whose = action_space.space, "each agent's"
    space = getattr(loss, "action_space", own)
    if space != own:
        raise use.refuse(
            f"the action_space of {kind} is {space}, but {whose} is {own}; give it that one"
        )
    if use.length < loss.least_length:
        raise use.refuse(
            f"{kind} learns nothing from sequences of {use.length} step(s); the shortest that it "
            f"learns from have {loss.least_length}"
        )
    try:
        loss.check_model(output)
    except JaxactError as error:
        hint = ""
        if isinstance(action_space, Agents) and isinstance(loss, _OF_ONE_AGENT):
            hint = "; AgentsActorCritic has none, so leave one agent with jaxact.opponents.against"
        raise use.refuse(f"{error}{hint}") from None


def _check_cordial(
    use: _Use, loss: Cordial, action_space: Space, output: ActorCriticOutput, observation: Any
) -> None:
    """The matrix must be of the joint actions of the agents that there are."""
    if not isinstance(action_space, Agents):
        raise use.refuse("Cordial is for worlds of several agents, and this one has one; use PPO")
    if loss.observation not in observation:
        raise use.refuse(unknown("reading", loss.observation, list(observation)))
    agents = action_space.count
    table = jax.eval_shape(lambda policy: joint_log_probs(policy, agents), output.distribution)
    found, needed = observation[loss.observation].shape[2:], table.shape[-agents:]
    if found != needed:
        raise use.refuse(
            f"the reading {loss.observation!r} must say what each joint action is, "
            f"{list(needed)} for each of {agents} agents, and is {list(found)}"
        )


def _check_shared(
    uses: list[_Use], output: ActorCriticOutput, observation: Any, action: Any
) -> None:
    """Losses of one name share their variables, which therefore must be of one kind and size."""
    first: dict[str, _Use] = {}
    key = jax.eval_shape(lambda: jax.random.key(0))
    for use in uses:
        if not use.loss.has_variables:
            continue
        other = first.setdefault(use.name, use)
        one, two = type(other.loss), type(use.loss)
        if one is not two:
            raise use.refuse(
                f"{two.__name__} would share its variables with the {one.__name__} of this name in "
                f"{other.where}; give one of them another name"
            )
        if use.loss != other.loss:
            shapes = [
                jax.eval_shape(x.loss.init, key, output, observation, action) for x in (other, use)
            ]
            if shapes[0] != shapes[1]:
                raise use.refuse(
                    f"it would share its variables with the {one.__name__} of this name in "
                    f"{other.where}, but is of another size; make both alike, or give one of them "
                    "another name"
                )


def _check_gail(where: str, stage: Stage) -> None:
    """A discriminator learns from both sides, which are two losses of one name."""
    for name, loss in stage.losses.items():
        if not isinstance(loss, GAIL):
            continue
        if loss.demonstrations:
            raise JaxactError(
                f"{where}: loss {name!r}: the GAIL among a stage's losses judges what the policy "
                "does; leave demonstrations=True to the one in a storage"
            )
        held = [
            of
            for of, storage in stage.storages.items()
            if isinstance(x := storage.losses.get(name), GAIL) and x.demonstrations
        ]
        if len(held) != 1:
            found = f"{' and '.join(map(repr, held))} have one each" if held else "none has one"
            raise JaxactError(
                f"{where}: loss {name!r}: GAIL needs demonstrations to tell the policy from, so "
                f"that one storage of the stage must have a GAIL(..., demonstrations=True) of the "
                f"name {name!r}, but {found}"
            )


def _check_priorities(where: str, storage: Storage) -> None:
    prioritized = type(storage).reprioritize is not Storage.reprioritize
    if prioritized and not any(loss.tells_priority for loss in storage.losses.values()):
        kinds = ", ".join(type(loss).__name__ for loss in storage.losses.values())
        raise JaxactError(
            f"{where}: none of its losses ({kinds}) tells a {type(storage).__name__} what its "
            "sequences are worth, as DQN does; use a Replay, which draws them uniformly"
        )


def _check_forcing(pipeline: TrainingPipeline) -> None:
    """Forced actions were not taken with the policy's probability, which some losses go by."""
    forced: dict[str, str] = {}
    for index, stage in enumerate(pipeline.stages):
        where, forcing = f"stage {index}", stage.teacher_forcing
        if forcing is not None and forcing != 0.0:
            taken_in = [name for name, storage in stage.storages.items() if storage.acts]
            forced |= dict.fromkeys(("", *taken_in), where)
        else:
            forced.pop("", None)
        groups = {"": stage.losses} | {n: storage.losses for n, storage in stage.storages.items()}
        for place, losses in groups.items():
            for name, loss in losses.items():
                if place in forced and "log_prob" in loss.needs:
                    raise JaxactError(
                        f"{where}: loss {name!r}: {type(loss).__name__} goes by the probability "
                        "with which the policy took its actions, so it cannot learn from forced "
                        f"ones: leave teacher_forcing out of {forced[place]}"
                    )
