"""Value-based and off-policy learning in whole pipelines, on worlds of a few cells."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import Experiment, JaxactError, Stage, TrainingPipeline, make_train
from jaxact.losses import DQN, PPO, PQN, SAC, Critic, Target, VTrace
from jaxact.models import GRU, ActorCritic, Concatenated, NoMemory, QNetwork, Vector
from jaxact.program import Program, choose_devices
from jaxact.schedules import Linear
from jaxact.spaces import Box
from jaxact.storages import PrioritizedReplay, Replay
from jaxact.train_state import make_key
from tests.corridor import corridor
from tests.point import Plane, point
from tests.tiny import Plain, raw

CORRIDOR, POINT = corridor(), point()
ENCODER = Concatenated({"vector": Vector((16,))})
MEMORYLESS = NoMemory()
EPSILON = Linear(1.0, 0.05, 3000.0)


def experiment(stage, model, pomdp=CORRIDOR, **settings):
    defaults = {
        "lanes": 8,
        "rollout_length": 8,
        "epochs": 2,
        "minibatches": 2,
        "learning_rate": 1e-2,
        "discount": 0.95,
    }
    return Experiment("small", pomdp, model, TrainingPipeline((stage,), **defaults | settings))


def q_network(memory=MEMORYLESS, **fields):
    return QNetwork(CORRIDOR.action_space, ENCODER, memory, hidden=16, **fields)


def replayed(kind, loss, exploration=EPSILON, steps=6400, **fields):
    defaults = {"losses": {"loss": loss}, "capacity": 256, "lanes": 32, "length": 8, "updates": 2}
    storage = kind(**defaults | fields)
    return Stage({}, steps=steps, exploration=exploration, storages={"replay": storage})


def r2d2(start_after):
    loss = DQN(discount=0.95, n_step=3, rescale=True, target=Target(every=20))
    fields = {"burn_in": 4, "stride": 4, "start_after": start_after}
    return experiment(replayed(PrioritizedReplay, loss, **fields), q_network(GRU(8)))


def success(metrics, last=20):
    """Of the episodes that ended in the last updates."""
    ended, count = (np.asarray(metrics[f"episodes/{n}"])[-last:] for n in ("success", "count"))
    return ended.sum() / count.sum()


def test_r2d2_learns_once_there_is_enough_to_learn_from():
    program = Program(r2d2(start_after=512), choose_devices(1))
    state = program.start(make_key(0))

    def learnt(state):
        return [np.asarray(x) for x in jax.tree.leaves((state.params, state.optimizer))]

    first, (variables,) = learnt(state), state.losses.values()
    for copy, params in zip(
        jax.tree.leaves(variables["target_model"]), jax.tree.leaves(state.params), strict=True
    ):
        np.testing.assert_array_equal(copy, params)

    advance = program.stage(0, 100)
    state, metrics = advance(state, program.numbers(), np.int32(7))
    assert all(np.array_equal(a, b) for a, b in zip(first, learnt(state), strict=True))
    assert not np.any(metrics["losses/replay/loss/error"])
    assert int(state.losses["loss"]["steps"]) == 0

    state, metrics = advance(state, program.numbers(), np.int32(93))
    assert np.all(np.asarray(metrics["losses/replay/loss/error"])[:93] > 0)
    assert int(state.losses["loss"]["steps"]) == 2 * 93
    assert success({n: x[:93] for n, x in metrics.items()}) > 0.9
    held = state.storages["replay"]
    assert held.steps.observation["vector"].shape == (8, 256, 12)
    assert raw(held.taken).tolist() == [800] * 8
    assert len(np.unique(held.priority)) > 100


def test_exploration_is_for_greedy_models():
    model = ActorCritic(CORRIDOR.action_space, ENCODER, NoMemory())
    stage = Stage({"ppo": PPO()}, steps=64, exploration=0.1)
    with pytest.raises(JaxactError, match="Categorical explores by itself"):
        jax.eval_shape(make_train(experiment(stage, model)), make_key(0))


def test_batches_must_divide_among_the_lanes():
    stage = replayed(Replay, DQN(), lanes=12)
    with pytest.raises(JaxactError, match="stage 0: storage 'replay': batches of 12 lanes"):
        experiment(stage, q_network()).check()


ACTOR_CRITIC = ActorCritic(CORRIDOR.action_space, ENCODER, NoMemory())
LEARNERS = {
    "dqn": (replayed(Replay, DQN(discount=0.95, target=Target(rate=0.1))), q_network()),
    "pqn": (Stage({"pqn": PQN()}, 6400, exploration=EPSILON), q_network(layer_norm=True)),
    "vtrace": (replayed(Replay, VTrace(), None, capacity=32, lanes=8, length=16), ACTOR_CRITIC),
    "vtrace on rollouts": (Stage({"vtrace": VTrace()}, 6400), ACTOR_CRITIC),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
def test_the_corridor_is_learnt(name):
    stage, model = LEARNERS[name]
    _, metrics = jax.jit(make_train(experiment(stage, model)))(make_key(0))
    assert success(metrics) > 0.9


def test_plain_action_values_are_learnt_from_rollouts_and_from_a_replay():
    """Of the two losses one has the weight zero."""
    encoder = Concatenated({"vector": Plain()})
    shape = {"hidden": 16, "layer_norm": True, "dueling": False}
    model = QNetwork(CORRIDOR.action_space, encoder, MEMORYLESS, **shape)
    dqn = {"losses": {"dqn": DQN(discount=0.95, target=Target(rate=0.1))}, "weights": {"dqn": 0.0}}
    replay = Replay(**dqn, capacity=64, lanes=32, length=8, updates=2)
    stage = Stage(
        {"pqn": PQN()}, 3840, weights={"pqn": 0.0}, exploration=Linear(1.0, 0.05, 2000.0),
        storages={"replay": replay},
    )  # fmt: skip
    numbers = {
        "pipeline.stages.0.weights.pqn": jnp.array([1.0, 0.0]),
        "pipeline.stages.0.storages.replay.weights.dqn": jnp.array([0.0, 1.0]),
    }
    train = jax.jit(jax.vmap(make_train(experiment(stage, model)), (None, 0)))
    _, metrics = train(make_key(0), numbers)
    for run in range(2):
        assert success({name: x[run] for name, x in metrics.items()}, last=15) > 0.95


@dataclass(frozen=True)
class Fine(Plane):
    """The plane with actions in units ten times as large."""

    @property
    def action_space(self):
        return Box(-0.1, 0.1, (2,))

    def step(self, key, state, action):
        return super().step(key, state, 10.0 * action)


def test_sac_steers_a_point_whatever_the_units_of_actions():
    world, encoder = replace(POINT, environment=Fine()), Concatenated({"vector": Plain()})
    loss = SAC(critic=Critic(encoder, (32,)), discount=0.9, target=Target(rate=0.02))
    fields = {"capacity": 512, "lanes": 64, "length": 2, "updates": 8, "start_after": 512}
    model = ActorCritic(world.action_space, encoder, NoMemory(), squashed=True)
    stage = replayed(Replay, loss, None, 6400, **fields)
    small = experiment(stage, model, world, max_grad_norm=10.0)
    _, metrics = jax.jit(make_train(small))(make_key(0))
    assert success(metrics) > 0.95


@pytest.mark.slow
def test_sac_steers_a_point():
    critic = Critic(Concatenated({"vector": Vector((32,))}), (32,))
    loss = SAC(critic=critic, discount=0.9, target=Target(rate=0.02))
    stage = replayed(
        Replay, loss, None, 12_800, capacity=1024, lanes=64, length=2, updates=8, start_after=512
    )
    encoder = Concatenated({"vector": Vector((32, 32))})
    model = ActorCritic(POINT.action_space, encoder, NoMemory(), squashed=True)
    small = experiment(stage, model, POINT, learning_rate=3e-3, max_grad_norm=10.0)
    _, metrics = jax.jit(make_train(small))(make_key(0))
    assert success(metrics) > 0.95
    # The temperature has found the entropy asked for, −1 a dimension.
    assert np.mean(metrics["losses/replay/loss/entropy"][-20:]) == pytest.approx(-2.0, abs=0.5)
