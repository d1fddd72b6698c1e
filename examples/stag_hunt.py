"""Markov Stag Hunt, learnt by two agents with heads of their own, after AllenAct's paper: a stag of
2×2 cells on a grid of 5×5, two plants, 45 steps.

python -m jaxact.train examples/stag_hunt.py:g1

A name after the colon is one of `experiments`: what meeting the stag alone costs, from `g0_5` to
`g3`; `g3_prosocial` are agents who care for what the other earns as much as for their own. In
`g1_past_selves` one agent learns beside what it was some updates ago; it is evaluated beside one
that has learnt nothing.
"""

import dataclasses

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.agents import MixedRewards
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, AgentsActorCritic, Concatenated, Vector
from jaxact.past_selves import against_past_selves
from jaxact.schedules import Linear

_STEPS = 3_000_000
_ENCODER = Concatenated({"map": Vector((64,), axes=3)})


def _name(maul_penalty: float) -> str:
    return f"g{maul_penalty:g}".replace(".", "_")


def _experiment(maul_penalty: float, others: float = 0.0) -> Experiment:
    pomdp = envs_jax.make("Markov-StagHunt-v0", maul_penalty=maul_penalty, stag_side=2, horizon=45)
    name = f"stag_hunt_{_name(maul_penalty)}"
    if others:
        pomdp = dataclasses.replace(pomdp, task=MixedRewards(pomdp.task, others=others))
        name += "_prosocial"
    return Experiment(
        name=name,
        pomdp=pomdp,
        model=AgentsActorCritic(pomdp.action_space, _ENCODER, GRU(64), shared="body"),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": PPO(clip=0.1)}, steps=_STEPS),),
            lanes=64,
            rollout_length=45,
            epochs=4,
            minibatches=2,
            learning_rate=Linear(1e-3, 0.0, steps=_STEPS),
        ),
    )


def _beside_past_selves(maul_penalty: float) -> Experiment:
    together = _experiment(maul_penalty)
    model = ActorCritic(together.pomdp.action_space.space, _ENCODER, GRU(64))
    return dataclasses.replace(
        together,
        name=f"{together.name}_past_selves",
        pomdp=against_past_selves(together.pomdp, model, size=8, every=25),
        model=model,
    )


experiments = {_name(g): _experiment(g) for g in (0.5, 1.0, 2.0, 3.0)}
experiments |= {f"{_name(g)}_prosocial": _experiment(g, others=1.0) for g in (2.0, 3.0)}
experiments["g1_past_selves"] = _beside_past_selves(1.0)
experiment = experiments["g1"]
