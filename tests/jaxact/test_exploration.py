"""Intrinsic rewards find a reward that is too far away to be found by chance."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import Experiment, Stage, TrainingPipeline, make_train
from jaxact.losses import PPO, Curiosity, RandomNetworkDistillation
from jaxact.models import ActorCritic, Concatenated, NoMemory
from jaxact.pomdp import Episode
from jaxact.train_state import make_key
from tests.corridor import RandomStart, ReachEnd, corridor
from tests.tiny import Plain

CELLS, HORIZON, LANES, LENGTH, UPDATES = 32, 48, 16, 24, 40
SEEDS = 2
KINDS = {"PPO alone": (0.0, 0.0), "novelty": (1.0, 0.0), "curiosity": (0.0, 100.0)}


@dataclass(frozen=True)
class FarAway(RandomStart):
    """From the left end to the right one, where in 48 steps hardly any random walk arrives."""

    def sample(self, key, sampler_state):
        del key, sampler_state
        return Episode(jnp.int32(0), jnp.int32(self.length - 1), jnp.int32(self.horizon))


@pytest.fixture(scope="module")
def found():
    """Episodes that succeeded in each update, [kinds, seeds, updates]."""
    pomdp = replace(
        corridor(CELLS, HORIZON), sampler=FarAway(CELLS, HORIZON), task=ReachEnd(step_penalty=0.0)
    )
    encoder, actions = Concatenated({"vector": Plain()}), pomdp.action_space
    losses = {
        # Normalised advantages would make much of chance while there is no reward.
        "ppo": PPO(clip=0.2, normalize_advantage=False),
        "novelty": RandomNetworkDistillation(encoder=encoder, features=16, hidden=16),
        "curiosity": Curiosity(action_space=actions, encoder=encoder, hidden=16),
    }
    rewards = {"success": 10.0, "novelty": 0.0, "curiosity": 0.0}
    stage = Stage(losses, UPDATES * LANES * LENGTH, rewards=rewards)
    pipeline = TrainingPipeline(
        (stage,), lanes=LANES, rollout_length=LENGTH, minibatches=2, epochs=4, learning_rate=1e-2
    )
    model = ActorCritic(actions, encoder, NoMemory())
    weights = np.repeat(np.asarray(list(KINDS.values()), np.float32), SEEDS, axis=0)
    numbers = {
        f"pipeline.stages.0.rewards.{name}": jnp.asarray(weights[:, i])
        for i, name in enumerate(("novelty", "curiosity"))
    }
    keys = jnp.stack([make_key(seed) for _ in KINDS for seed in range(SEEDS)])
    train = jax.jit(jax.vmap(make_train(Experiment("far", pomdp, model, pipeline))))
    _, metrics = train(keys, numbers)
    return np.asarray(metrics["episodes/success"]).reshape(len(KINDS), SEEDS, UPDATES)


def test_chance_does_not_find_it(found):
    assert found[0].sum() == 0


@pytest.mark.parametrize("kind", list(KINDS)[1:])
def test_intrinsic_rewards_find_it_and_then_it_is_learnt(found, kind):
    of_kind = found[list(KINDS).index(kind)]
    # In ten updates a lane that does not tarry plays seven episodes.
    assert (of_kind[:, -10:].sum(-1) > 0.75 * 7 * LANES).all()
