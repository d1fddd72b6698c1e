"""What would train in silence without learning what was meant is refused with a sentence."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

import jaxact
from jaxact import JaxactError, Stage
from jaxact.losses import (
    A2C,
    CPCA,
    DQN,
    GAIL,
    PPO,
    PQN,
    SAC,
    Advisor,
    Critic,
    Curiosity,
    FusionEntropy,
    GroupedImitation,
    Imitation,
    InverseDynamics,
    KLToReference,
    Target,
    TemporalDistance,
    VTrace,
)
from jaxact.models import GRU, ActorCritic, Concatenated, NoMemory, QNetwork, Vector
from jaxact.search_space import uniform
from jaxact.spaces import Box, Dict, Discrete
from jaxact.storages import DemonstrationStorage, PrioritizedReplay, Replay
from tests.corridor import corridor
from tests.tiny import experiment

OFFLINE = {"offline": DemonstrationStorage(losses={"bc": Imitation()}, path="nowhere")}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DQN(n_step=0), "n_step of DQN must be at least 1, got 0"),
        (lambda: Target(every=0), "every of Target must be at least 1, got 0"),
        (lambda: TemporalDistance(pairs=0), "pairs of TemporalDistance must be at least 1"),
        (lambda: CPCA(action_space=Discrete(2), steps=0), "steps of CPCA must be at least 1"),
        (lambda: GroupedImitation(((), (0, 1))), "each of one or more numbers from 0"),
        (lambda: Stage({"ppo": PPO}, 1), r"'ppo' of a stage is no loss .* write PPO\(...\)"),
        (
            lambda: Stage({}, 1, storages=replay(VTrace)),
            r"'it' of storage 'replay' is no loss .* write VTrace\(...\)",
        ),
        (lambda: Stage({"ppo": 0.5}, 1), "'ppo' of a stage is no loss but 0.5"),
        (
            lambda: Stage({}, 1, storages=OFFLINE, teacher_forcing=0.5),
            "teacher_forcing is about rollouts, and a stage that learns from 'offline' alone",
        ),
        (lambda: Stage({}, 1, storages=OFFLINE, exploration=0.5), "exploration is about rollouts"),
        (
            lambda: jaxact.sweep(experiment(), {"pipeline.discount": uniform(0, 1)}, seeds=3),
            r"seeds must be several numbers, such as \(3,\), got 3",
        ),
    ],
)
def test_numbers_and_things_that_mean_nothing(make, message):
    with pytest.raises(JaxactError, match=message):
        make()


ACTIONS, ENCODER = corridor().action_space, Concatenated({"vector": Vector((4,))})
GREEDY = QNetwork(ACTIONS, ENCODER, NoMemory())
CURIOUS = Curiosity(action_space=ACTIONS, encoder=ENCODER, hidden=8)
DISCRIMINATOR = GAIL(action_space=ACTIONS, encoder=ENCODER)
JUDGE = dataclasses.replace(DISCRIMINATOR, demonstrations=True)
SIDES = {"ppo": PPO(), "gail": DISCRIMINATOR}


def stage_of(losses, storages=(), **fields):
    return Stage(losses, 64, storages=dict(storages), **fields)


def replay(loss, kind=Replay, **fields):
    return {"replay": kind(losses={"it": loss}, capacity=64, lanes=8, **fields)}


def recorded(name, loss, of="offline"):
    return {of: DemonstrationStorage(losses={name: loss}, path="nowhere")}


def trained_by(*stages, model=None, **settings):
    whole = experiment()
    pipeline = dataclasses.replace(whole.pipeline, stages=stages, **settings)
    return dataclasses.replace(whole, pipeline=pipeline, model=model or whole.model)


def test_losses_that_can_work_are_let_be():
    stages = (
        stage_of(SIDES, recorded("gail", JUDGE)),
        stage_of(SIDES, recorded("gail", JUDGE) | replay(VTrace()), teacher_forcing=0.0),
        stage_of({"ppo": PPO(), "curiosity": CURIOUS}),
        stage_of({"ppo": PPO(), "curiosity": dataclasses.replace(CURIOUS, eta=1.0)}),
        stage_of({"groups": GroupedImitation([[0, 1]])}, teacher_forcing=1.0),
    )
    trained_by(*stages).check()
    trained_by(stage_of({}, replay(DQN(), PrioritizedReplay)), model=GREEDY).check()


@pytest.mark.parametrize(
    ("stages", "model", "message"),
    [
        (
            [stage_of(SIDES)],
            None,
            r"stage 0: loss 'gail': GAIL needs demonstrations .* of the name 'gail', but none has",
        ),
        (
            [stage_of(SIDES, recorded("gail", DISCRIMINATOR))],
            None,
            "'gail': GAIL needs demonstrations .* but none has one",
        ),
        (
            [stage_of(SIDES, recorded("gail", JUDGE) | recorded("gail", JUDGE, "more"))],
            None,
            "but 'offline' and 'more' have one each",
        ),
        (
            [stage_of({"ppo": PPO(), "gail": JUDGE}, recorded("gail", JUDGE))],
            None,
            "leave demonstrations=True to the one in a storage",
        ),
        (
            [stage_of({}, replay(VTrace(), PrioritizedReplay))],
            None,
            r"stage 0: storage 'replay': none of its losses \(VTrace\) tells .* use a Replay",
        ),
        (
            [stage_of({}, replay(DQN(), length=1))],
            GREEDY,
            r"'it': DQN learns nothing from sequences of 1 step.* have 2",
        ),
        (
            [stage_of({"ppo": PPO(), "t": TemporalDistance(longer_than=7)})],
            None,
            r"TemporalDistance learns nothing from sequences of 8 step.* have 9",
        ),
        (
            [stage_of({"vtrace": VTrace()}, teacher_forcing=0.5)],
            None,
            "VTrace goes by the probability .* leave teacher_forcing out of stage 0",
        ),
        (
            [
                stage_of({"it": CURIOUS, "ppo": PPO()}, replay(CURIOUS), teacher_forcing=1.0),
                stage_of({}, replay(VTrace())),
            ],
            None,
            "stage 1: loss 'it': VTrace .* leave teacher_forcing out of stage 0",
        ),
        ([stage_of({"a2c": A2C()})], GREEDY, "'a2c': A2C learns a policy, but .* such as ActorCr"),
        ([stage_of({"bc": Imitation()})], GREEDY, "Imitation learns a policy, but the model's"),
        ([stage_of({}, replay(DQN()))], None, "'it': Q-learning needs a model of action values"),
        ([stage_of({"pqn": PQN()})], None, "needs a model of action values, such as QNetwork"),
        ([stage_of({"a": Advisor()})], None, r"ActorCritic\(..., auxiliary_actor=True\)"),
        ([stage_of({"f": FusionEntropy()})], None, r"memory=MultipleBeliefs\(...\)"),
        ([stage_of({"kl": KLToReference()})], GREEDY, "EpsilonGreedy has no closed form"),
        (
            [stage_of({}, replay(SAC(critic=Critic(ENCODER))))],
            None,
            "stage 0: storage 'replay': loss 'it': SAC is for policies on a bounded box",
        ),
        (
            [stage_of({"i": InverseDynamics(action_space=ACTIONS, belief="blief")})],
            None,
            "unknown feature of the model, in a loss 'blief'; the nearest is 'belief'",
        ),
        (
            [stage_of({"i": InverseDynamics(action_space=Discrete(5))})],
            None,
            r"action_space of InverseDynamics is Discrete\(n=5\), but the world's is Discrete\(n=2",
        ),
        ([stage_of({"g": GroupedImitation(((0, 5),))})], None, "there are 2 actions, so none is 5"),
        (
            [
                stage_of({"ppo": PPO(), "x": InverseDynamics(action_space=ACTIONS)}),
                stage_of({"ppo": PPO(), "x": TemporalDistance()}),
            ],
            None,
            "stage 1: loss 'x': TemporalDistance would share .* the InverseDynamics .* stage 0",
        ),
        (
            [
                stage_of({"ppo": PPO(), "x": CURIOUS}),
                stage_of({"ppo": PPO(), "x": dataclasses.replace(CURIOUS, hidden=16)}),
            ],
            None,
            "stage 1: loss 'x': it would share .* in stage 0, but is of another size",
        ),
    ],
)
def test_losses_that_cannot_work_where_they_stand(stages, model, message):
    with pytest.raises(JaxactError, match=message):
        trained_by(*stages, model=model).check()


def test_a_rewarding_loss_has_a_name_of_its_own():
    with pytest.raises(JaxactError, match="'success' rewards under its own name, which is that of"):
        trained_by(stage_of({"ppo": PPO(), "success": CURIOUS})).check()


@pytest.mark.parametrize("model", [ActorCritic, QNetwork])
def test_an_encoder_that_does_not_give_vectors(model):
    space = Dict({"map": Box(0, 1, (4, 4, 2), "uint8")})
    observation = jax.tree.map(lambda x: x[None], space.zeros())

    def init(axes):
        encoder = Concatenated({"map": Vector((8,), axes=axes)})
        made = model(Discrete(3), encoder, GRU(8))
        rest = made.initial_memory(1), jnp.zeros(1, jnp.int32), jnp.ones(1, bool)
        return jax.eval_shape(made.init, jax.random.key(0), observation, *rest)

    with pytest.raises(JaxactError, match=r"features of shape \(1, 4, 4, 8\) .* needs \[1, F\]"):
        init(axes=1)
    kernel = init(axes=3)["params"]["encoder"]["encoders_map"]["Dense_0"]["kernel"]
    assert kernel.shape == (4 * 4 * 2, 8)
