r"""ADVISOR's experiments where the expert knows too much (Weihs et al. 2021, figure 4).

python -m jaxact.train examples/advisor.py:poisoned_doors_advisor

A name after the colon is one of `experiments`: a world and a method. Numbers that ADVISOR's random
search draws are `pipeline.learning_rate.start`, `alpha`, and for warm starts how long they are,
which is one number in several schedules: see `search_space`. `advisor_demonstrations` learns from
recorded ones as well:

python -m jaxact.collect Advisor-PoisonedDoors-v0 --episodes 10000 --output \
    demonstrations/poisoned_doors

As in the study, crossings of lava that were failed are given again, until 1000 steps were spent on
them, and the network is AllenAct's: no layer between the cells' embeddings and the memory, and
actors that begin with orthogonal weights of gain 1.
"""

import dataclasses
from collections.abc import Mapping

import optax

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, Advisor, AdvisorImitation, Imitation
from jaxact.models import LSTM, ActorCritic, Concatenated, ProjectedGrid, Vector
from jaxact.samplers import RepeatFailed
from jaxact.schedules import Linear, Piecewise
from jaxact.search_space import Range, choice, log_uniform, uniform
from jaxact.storages import DemonstrationStorage

_lava = envs_jax.make("Advisor-LavaCrossingCorruptExpertS15N7-v0")
_lava = dataclasses.replace(_lava, sampler=RepeatFailed(_lava.sampler, size=500))
# Unseen, empty, wall, lava and goal, as MiniGrid encodes them.
_CELLS = ((0, 0, 0), (1, 0, 0), (2, 5, 0), (9, 0, 0), (8, 1, 0))
# World, encoder, memory, and steps as published.
WORLDS = {
    "lava_crossing": (_lava, ProjectedGrid(4 * 128, _CELLS), LSTM(128, projects=False), 1e6),
    "poisoned_doors": (
        envs_jax.make("Advisor-PoisonedDoors-v0"),
        Concatenated({"stage": Vector((128,))}),
        LSTM(128),
        3e5,
    ),
}


def _stages(world: str, length: float) -> dict[str, Stage]:
    """Returns a stage for each method, warm starts half as long as the whole."""
    steps, half = int(length), length / 2
    ppo, imitation = PPO(clip=Linear(0.1, 0.0, length)), Imitation()
    both: Mapping[str, PPO | Imitation] = {"imitation": imitation, "ppo": ppo}
    first = {
        "imitation": Piecewise((half,), (1.0, 0.0)),
        "ppo": Piecewise((half,), (0.0, 1.0)),
    }
    forced_first = Piecewise((half,), (1.0, 0.0))
    fading = Linear(1.0, 0.0, half)
    demonstrations = DemonstrationStorage(
        losses={"advisor": AdvisorImitation(alpha=8.0)},
        path=f"demonstrations/{world}",
        updates=4,
        lanes=20,
        length=100,
    )
    return {
        "ppo": Stage({"ppo": ppo}, steps),
        "bc": Stage({"imitation": imitation}, steps),
        "dagger": Stage({"imitation": imitation}, steps, teacher_forcing=fading),
        "bc_forced": Stage({"imitation": imitation}, steps, teacher_forcing=1.0),
        "bc_to_ppo": Stage(both, steps, weights=first),
        "dagger_to_ppo": Stage(both, steps, weights=first, teacher_forcing=fading),
        "bc_forced_to_ppo": Stage(both, steps, weights=first, teacher_forcing=forced_first),
        "advisor": Stage({"advisor": Advisor(reinforcement=ppo)}, steps),
        "advisor_demonstrations": Stage(
            {"ppo": ppo},
            steps,
            storages={"demonstrations": demonstrations},
            overrides={"epochs": 2},
        ),
    }


def search_space(name: str) -> dict[str | tuple[str, ...], Range]:
    """Returns what ADVISOR's random search draws for one of `experiments`.

    Learning rates are log-uniform in [1e-4, 0.5], the warm start's share of the steps uniform in
    [0.1, 0.9], and α one of 4, 8, 16 and 32.
    """
    world = next(world for world in WORLDS if name.startswith(world))
    method, steps = name.removeprefix(f"{world}_"), WORLDS[world][3]
    stage = "pipeline.stages.0"
    space: dict[str | tuple[str, ...], Range] = {
        "pipeline.learning_rate.start": log_uniform(1e-4, 0.5)
    }
    lengths = []
    if method.startswith("dagger"):
        lengths.append(f"{stage}.teacher_forcing.steps")
    if method.endswith("_to_ppo"):
        lengths += [f"{stage}.weights.{loss}.boundaries.0" for loss in ("imitation", "ppo")]
    if method == "bc_forced_to_ppo":
        lengths.append(f"{stage}.teacher_forcing.boundaries.0")
    if lengths:
        space[tuple(lengths)] = uniform(0.1 * steps, 0.9 * steps)
    alpha = {
        "advisor": f"{stage}.losses.advisor.alpha",
        "advisor_demonstrations": f"{stage}.storages.demonstrations.losses.advisor.alpha",
    }
    if method in alpha:
        space[alpha[method]] = choice(4, 8, 16, 32)
    return space


def _experiments() -> dict[str, Experiment]:
    found = {}
    for world, (pomdp, encoder, memory, steps) in WORLDS.items():
        for method, stage in _stages(world, steps).items():
            model = ActorCritic(
                pomdp.action_space,
                encoder,
                memory,
                auxiliary_actor=method.startswith("advisor"),
                actor_gain=1.0,
            )
            pipeline = TrainingPipeline(
                (stage,),
                lanes=20,
                rollout_length=100,
                epochs=4,
                minibatches=2,
                gae_lambda=1.0,
                learning_rate=Linear(3e-3, 0.0, steps),
                optimizer=optax.adam,
                optimizer_options={"eps": 1e-8},
            )
            variant = f"{world}_{method}"
            found[variant] = Experiment(f"advisor_{variant}", pomdp, model, pipeline)
    return found


experiments = _experiments()
experiment = experiments["poisoned_doors_advisor"]
