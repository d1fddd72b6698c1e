"""Training from recorded demonstrations, alone and beside rollouts."""

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import (
    Experiment,
    JaxactError,
    Stage,
    TrainingPipeline,
    evaluate_policy,
    make_train,
    train,
)
from jaxact.collect import collect
from jaxact.losses import A2C, Imitation, Loss, VTrace
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from jaxact.storages import DemonstrationStorage, Replay
from jaxact.train_state import make_key
from tests.corridor import corridor
from tests.tiny import OPTIONS, UPDATE, assert_same, experiment

EPISODES = 90


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    directory = tmp_path_factory.mktemp("demonstrations") / "corridor"
    collect(corridor(), directory, EPISODES, world="corridor", progress=False)
    return str(directory)


@dataclass(frozen=True)
class Rewarded(Loss):
    """Tells what it sees of the reward."""

    needs: ClassVar[frozenset[str]] = frozenset({"reward"})

    def __call__(self, output, batch, progress):
        return jnp.mean(output.value), {"reward": batch.mean(batch.reward)}


def storage(path, **fields):
    defaults = {"losses": {"imitation": Imitation()}, "lanes": 8, "length": 8}
    return DemonstrationStorage(path=path, **defaults | fields)


def test_what_was_demonstrated_is_learnt_without_ever_acting(path):
    stage = Stage(losses={}, steps=60 * UPDATE, storages={"demonstrations": storage(path)})
    small = experiment(stages=(stage,), learning_rate=1e-2)
    result = train(small, evaluate_every=0, evaluation_episodes=0, progress=False)
    assert "episodes/count" not in result.metrics
    error = result.metrics["losses/demonstrations/imitation/cross_entropy"]
    assert error[-1] < 0.1 < 0.5 < error[0]
    assert evaluate_policy(corridor(), result.policy, 200).success.mean() > 0.95


def test_resumed_bit_for_bit_beside_rollouts(path, tmp_path):
    """The place in the demonstrations and the memory there are part of the state."""
    held = storage(path, updates=2)
    stages = (
        Stage({"a2c": A2C()}, steps=4 * UPDATE, storages={"demonstrations": held}),
        Stage({}, steps=4 * held.steps, storages={"demonstrations": replace(held, updates=1)}),
    )
    both = experiment(stages=stages)
    whole = train(both, **OPTIONS)
    first = train(both, **OPTIONS, output=tmp_path, total_steps=2 * UPDATE)
    rest = train(both, **OPTIONS, resume=first.run)
    assert_same(rest.state, whole.state)
    served = np.asarray(whole.state.storages["demonstrations"]["cursor"].offset)
    assert served.shape == (8,)
    assert np.isfinite(whole.metrics["losses/a2c/policy"][:4]).all()


def test_of_another_world_or_not_there(path):
    other = experiment(
        corridor(length=4),
        stages=(Stage({}, steps=1, storages={"demonstrations": storage(path)}),),
    )
    with pytest.raises(JaxactError, match="vector"):
        train(other, evaluation_episodes=0, progress=False)
    missing = Stage({}, steps=1, storages={"demonstrations": storage(f"{path}-not")})
    with pytest.raises(JaxactError, match="corridor-not"):
        train(experiment(stages=(missing,)), evaluation_episodes=0, progress=False)


def test_what_nobody_knows_of_demonstrations_cannot_be_used(path):
    held = storage(path)
    pomdp, model = corridor(), experiment().model
    data = held.load(pomdp)
    state = held.init(pomdp, model, jax.random.split(jax.random.key(0), 8), data)
    _, batch = jax.jit(lambda state, data: held.batch(state, data, None))(state, data)
    for name in ("log_prob", "value", "advantage", "normalized_advantage", "returns"):
        for use in (jnp.exp, lambda x: jnp.zeros(3) - x, lambda x: x[1:], lambda x: x.shape):
            with pytest.raises(JaxactError, match=f"asks for '{name}', which a Demonstration"):
                use(getattr(batch, name))
    assert np.asarray(batch.is_first)[0].all()
    assert np.asarray(batch.expert.valid).all()


def test_losses_that_need_what_is_not_kept_are_refused():
    with pytest.raises(JaxactError, match=r"VTrace \('v'\) needs 'log_prob', which a De.*Replay"):
        DemonstrationStorage(losses={"v": VTrace()}, path="anywhere")
    with pytest.raises(JaxactError, match=r"Imitation .*'expert', which a Replay .*Demonstration"):
        Replay(losses={"imitation": Imitation()}, capacity=64)


def test_stages_weigh_the_components_of_the_reward(path):
    """On the disk they are apart; where they are not, the reward cannot be used."""
    pomdp = corridor()
    model = ActorCritic(pomdp.action_space, Concatenated({"vector": Vector((4,))}), NoMemory())
    held = storage(path, losses={"seen": Rewarded()})
    stage = Stage({}, 2 * held.steps, storages={"d": held}, rewards={"success": 5.0, "step": 0.0})
    run = make_train(Experiment("weighed", pomdp, model, TrainingPipeline((stage,), lanes=8)))
    data = held.load(pomdp)
    terms = data.reward_terms
    np.testing.assert_allclose(terms["success"] + terms["step"], data.reward)

    _, metrics = jax.jit(run)(make_key(0), {}, {"d": data})
    seen = np.asarray(metrics["losses/d/seen/reward"])
    # In 64 steps so many episodes succeed, each with five for its success and nothing besides.
    np.testing.assert_array_equal(seen * 64 % 5, 0)
    assert (seen > 0.5).all()
    bare = {"d": replace(data, reward_terms={})}
    with pytest.raises(JaxactError, match=r"Rewarded .* needs the reward, .* \(success, step\)"):
        jax.eval_shape(run, make_key(0), {}, bare)
