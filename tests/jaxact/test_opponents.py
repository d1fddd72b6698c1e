"""Agents that given policies play: they act as these do, and the learner's world is the same."""

import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
import jaxact
from jaxact import Experiment, JaxactError, Stage, TrainingPipeline
from jaxact.collect import collect
from jaxact.evaluate import load_policy
from jaxact.game import Game
from jaxact.gymnasium_adapter import to_gymnasium
from jaxact.losses import PPO, Imitation
from jaxact.models import GRU, ActorCritic, AgentsActorCritic, Concatenated, NoMemory, Vector
from jaxact.opponents import against
from jaxact.overrides import fingerprint
from jaxact.policy import Policy
from jaxact.spaces import Agents, Discrete
from jaxact.storages import DemonstrationStorage
from tests.corridor import corridor
from tests.crowd import crowd
from tests.tiny import assert_same

ENCODER = Concatenated({"vector": Vector((16,))})
WORLD = crowd(3)
STEPS = 12


def policy_of(agents, seed=0, **settings):
    """An untrained policy of so many walkers, or of one without an axis."""
    space = Discrete(2) if agents is None else Agents(Discrete(2), agents)
    shape = () if agents is None else (agents,)
    kind = ActorCritic if agents is None else AgentsActorCritic
    model = kind(space, ENCODER, GRU(8), previous_action=True, **settings)
    params = model.init(
        jax.random.key(seed),
        {"vector": jnp.zeros((1, *shape, 12), jnp.float32)},
        model.initial_memory(1),
        jnp.zeros((1, *shape), jnp.int32),
        jnp.ones(1, bool),
    )
    # Sharp enough that what it sees and remembers decides.
    return Policy(model, jax.tree.map(lambda x: 4 * x, params), space)


def by_hand(world, policies, greedy=False):
    """Plays a world in which all but the learners, who walk to and fro, ask their policies."""

    @jax.jit
    def step(key, t, state, observation, memories):
        keys = jax.random.split(jax.random.fold_in(key, t), 1 + len(policies))
        action, after = jnp.full(world.num_agents, t // 3 % 2, jnp.int32), []
        for own, memory, (agents, policy) in zip(keys[1:], memories, policies.items(), strict=True):
            whole = policy.action_space == world.action_space
            index = agents[0] if len(agents) == 1 else jnp.asarray(agents)
            seen = observation if whole else {"vector": observation["vector"][index]}
            chosen, memory = policy.act(own, seen, memory, greedy)
            action = action.at[index].set(chosen[index] if whole else chosen)
            after.append((whole, memory))
        memories = [
            dataclasses.replace(memory, previous_action=action) if whole else memory
            for whole, memory in after
        ]
        return *world.step(keys[0], state, action), action, memories

    key = jax.random.key(1)
    state, observation = jax.jit(world.reset)(key)
    memories = [policy.initial_memory() for policy in policies.values()]
    rows = [(observation, None, None)]
    for t in range(STEPS):
        state, result, action, memories = step(key, jnp.int32(t), state, observation, memories)
        observation = result.observation
        rows.append((observation, result, action))
    return rows


def by_learners(world):
    """Plays the world that is left, with the same moves."""
    step, key = jax.jit(world.step), jax.random.key(1)
    state, observation = jax.jit(world.reset)(key)
    rows = [(observation, None)]
    for t in range(STEPS):
        action = jnp.full(world.action_space.structure.shape, t // 3 % 2, jnp.int32)
        state, result = step(jax.random.fold_in(key, t), state, action)
        rows.append((result.observation, result))
    return rows


@pytest.mark.parametrize(
    ("policies", "greedy"),
    [
        ({(1,): policy_of(3)}, False),
        ({(0, 2): policy_of(2)}, True),
        ({(2,): policy_of(None), (0,): policy_of(None, seed=1)}, False),
    ],
    ids=["of all", "of a group", "of one each"],
)
def test_learners_see_and_earn_what_they_would_beside_these_policies(policies, greedy):
    left = against(WORLD, policies, greedy=greedy)
    played = {agent for agents in policies for agent in agents}
    learners = [agent for agent in range(3) if agent not in played]
    index = learners[0] if len(learners) == 1 else np.array(learners)
    assert left.num_agents == len(learners)
    assert isinstance(left.action_space, Agents) is (len(learners) > 1)
    expected, got = by_hand(WORLD, policies, greedy), by_learners(left)
    moved = set()
    for (observation, step, action), (seen, outcome) in zip(expected, got, strict=True):
        chex.assert_trees_all_close(seen["vector"], observation["vector"][index])
        if outcome is not None:
            chex.assert_trees_all_close(outcome.reward, step.reward[index])
            terms = {n: x[index] for n, x in step.reward_terms.items()}
            assert_same(outcome.reward_terms, terms)
            for name in ("terminated", "truncated", "success", "metrics"):
                assert_same(getattr(outcome, name), getattr(step, name))
            moved |= {int(action[agent]) for agent in played}
    assert moved == {0, 1}


def test_the_world_that_is_left_is_one_like_any_other():
    alone = against(WORLD, {(0, 1): policy_of(2)})
    assert alone.has_expert
    env = to_gymnasium(alone, seed=0)
    observation, _ = env.reset()
    assert observation["vector"].shape == (12,)
    with pytest.raises(JaxactError, match="several agents"):
        against(alone, {0: policy_of(None)})


def test_pictures_are_the_worlds_own():
    world = envs_jax.make("Markov-StagHunt-v0")
    model = ActorCritic(Discrete(4), Concatenated({"map": Vector((8,), axes=3)}), NoMemory())
    zeros = {"map": jnp.zeros((1, 5, 5, 4), jnp.uint8)}
    params = model.init(
        jax.random.key(0),
        zeros,
        model.initial_memory(1),
        jnp.zeros(1, jnp.int32),
        jnp.ones(1, bool),
    )
    left = against(world, {1: Policy(model, params, Discrete(4))})
    assert left.environment.action_names == ("left", "down", "right", "up")
    state, observation = jax.jit(left.reset)(jax.random.key(0))
    assert observation["map"].shape == (5, 5, 4)
    whole = world.begin(world.sampler.sample(jax.random.split(jax.random.key(0))[1], ()))
    assert_same(jax.jit(left.pictures)(state), jax.jit(world.pictures)(whole))
    assert not against(WORLD, {1: policy_of(3)}).has_pictures


def test_a_policy_of_a_run_is_played_against(tmp_path):
    """As it stands in the run's checkpoint."""
    pipeline = TrainingPipeline((Stage({"ppo": PPO()}, 64),), lanes=4, rollout_length=8)
    model = AgentsActorCritic(crowd(2).action_space, ENCODER, GRU(8))
    of_two = Experiment("first", crowd(2), model, pipeline)
    quiet = {"progress": False, "evaluate_every": 0, "evaluation_episodes": 0}
    first = jaxact.train(of_two, output=tmp_path, **quiet)
    policy = load_policy(first.run, of_two)
    assert_same(policy.params, first.policy.params)
    left = against(crowd(2), {1: policy})
    assert isinstance(left.environment, Game)
    assert_same(left.environment.opponents[0].policy.params, first.policy.params)
    single = ActorCritic(left.action_space, ENCODER, GRU(8))
    experiment = Experiment("second", left, single, pipeline)
    experiment.check()
    assert "array" not in repr(left)
    # What is kept of a run tells two opponents apart.
    other = against(crowd(2), {1: policy_of(2)})
    assert fingerprint(experiment) != fingerprint(dataclasses.replace(experiment, pomdp=other))


@pytest.mark.slow
def test_one_agents_expert_is_recorded_and_learnt_from_beside_others(tmp_path):
    left = against(crowd(2), {1: policy_of(None)})
    collect(left, tmp_path / "recorded", 20, world="left", progress=False)
    recorded = DemonstrationStorage(
        losses={"imitation": Imitation()}, path=str(tmp_path / "recorded"), lanes=4, length=8
    )
    stage = Stage({"ppo": PPO()}, 512, storages={"recorded": recorded})
    pipeline = TrainingPipeline((stage,), lanes=4, rollout_length=8, learning_rate=2e-2)
    model = ActorCritic(left.action_space, ENCODER, GRU(8))
    quiet = {"progress": False, "evaluate_every": 0, "evaluation_episodes": 0}
    metrics = jaxact.train(Experiment("left", left, model, pipeline), **quiet).metrics
    agreement = metrics["losses/recorded/imitation/agreement"]
    # Of two actions; an untrained policy agrees in half of the steps.
    assert agreement[-4:].mean() > 0.9


@pytest.mark.parametrize(
    ("policies", "sentence"),
    [
        ({3: policy_of(3)}, "there is no agent 3: they are 0 to 2"),
        ({(0, 1): policy_of(2), 1: policy_of(3)}, "agent 1 is played by two policies"),
        ({(0, 1, 2): policy_of(3)}, "all 3 agents are played by given policies"),
        ({1: policy_of(2)}, r"agent\(s\) 1 must choose from Discrete\(n=2\), or from Agents"),
        ({(0, 1): policy_of(None)}, r"agent\(s\) 0, 1 must choose from Agents.*count=2"),
    ],
)
def test_policies_that_do_not_fit_are_refused(policies, sentence):
    with pytest.raises(JaxactError, match=sentence):
        against(WORLD, policies)


def test_a_policy_that_cannot_read_the_world_is_refused():
    longer = crowd(3, length=8)
    with pytest.raises(JaxactError, match=r"cannot read what they see, vector float32\[3, 16\]"):
        against(longer, {1: policy_of(3)})
    with pytest.raises(JaxactError, match="worlds of several agents"):
        against(corridor(), {0: policy_of(None)})
    left = against(WORLD, {1: policy_of(3)})
    with pytest.raises(JaxactError, match="cannot judge Walkers"):
        dataclasses.replace(left, environment=WORLD.environment)
