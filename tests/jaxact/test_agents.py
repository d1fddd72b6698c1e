"""The axis of agents: a crowd of one is a corridor, and a crowd learns."""

import dataclasses
import shutil

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
import jaxact
from jaxact import Experiment, JaxactError, Stage, TrainingPipeline
from jaxact.agents import ForAll, MixedRewards, as_agents, as_lanes
from jaxact.collect import collect
from jaxact.gymnasium_adapter import to_gymnasium
from jaxact.gymnax_adapter import to_gymnax
from jaxact.losses import (
    A2C,
    PPO,
    PQN,
    AdvisorImitation,
    Cordial,
    Imitation,
    InverseDynamics,
    RandomNetworkDistillation,
)
from jaxact.models import (
    GRU,
    ActorCritic,
    AgentsActorCritic,
    CentralActor,
    Concatenated,
    QNetwork,
    SyncActor,
    Vector,
)
from jaxact.policy import Policy
from jaxact.program import make_train
from jaxact.recording import record_episode
from jaxact.schedules import Linear
from jaxact.search_space import choice
from jaxact.spaces import Agents, Discrete
from jaxact.testing import check_pomdp
from jaxact.video import annotate
from tests.corridor import CellAndGoal, corridor
from tests.crowd import ReachEnds, crowd
from tests.tiny import OPTIONS, UPDATE, assert_same

ENCODER = Concatenated({"vector": Vector((16,))})


class Flat(nn.Module):
    """A map of planes as one vector."""

    @nn.compact
    def __call__(self, image):
        return image.reshape(*image.shape[:-3], -1).astype(jnp.float32)


def experiment(pomdp, model, stages, **settings):
    defaults = {"lanes": 8, "rollout_length": 8, "minibatches": 2, "epochs": 2}
    pipeline = TrainingPipeline(stages, **defaults | {"learning_rate": 2e-2} | settings)
    return Experiment("crowd", pomdp, model, pipeline)


def of_crowd(agents, stages, shared="all", **settings):
    pomdp = crowd(agents)
    model = AgentsActorCritic(pomdp.action_space, ENCODER, GRU(8), shared=shared)
    return experiment(pomdp, model, stages, **settings)


def train(experiment, **options):
    quiet = {"progress": False, "evaluate_every": 0}
    return jaxact.train(experiment, **quiet | options)


def test_a_world_of_agents_passes_the_smoke_test():
    check_pomdp(crowd(3))


def test_a_crowd_of_one_learns_what_a_single_agent_learns():
    """DAgger and PPO, from the same seed: one axis more, and the same numbers."""
    stages = (
        Stage({"imitation": Imitation()}, 256, teacher_forcing=Linear(1.0, 0.0, 256.0)),
        Stage({"ppo": PPO()}, 256),
    )
    alone = corridor()
    model = ActorCritic(alone.action_space, ENCODER, GRU(8))
    one = train(experiment(alone, model, stages), evaluation_episodes=64)
    other = train(of_crowd(1, stages), evaluation_episodes=64)
    chex.assert_trees_all_equal_shapes(one.policy.params, other.policy.params)
    chex.assert_trees_all_close(one.policy.params, other.policy.params, atol=1e-4)
    for name, values in one.metrics.items():
        np.testing.assert_allclose(other.metrics[name], values, atol=1e-3, err_msg=name)
    np.testing.assert_allclose(other.evaluation.episode_return, one.evaluation.episode_return)


@pytest.mark.parametrize("shared", ["all", "body", "nothing"])
def test_crowds_learn_whatever_they_share(shared):
    stages = (Stage({"ppo": PPO()}, 15_360),)
    result = train(of_crowd(2, stages, shared, lanes=32), evaluation_episodes=200)
    found = result.evaluation
    assert found.success.mean() > 0.9
    each = [found.metrics[f"agents/{i}/return"] for i in range(2)]
    np.testing.assert_allclose(np.mean(each, axis=0), found.episode_return, atol=1e-5)
    sizes = {name: x["kernel"].ndim for name, x in _layers(result.policy.params).items()}
    own = {"all": set(), "body": {"actor", "critic"}, "nothing": set(sizes)}
    assert {name for name, ndim in sizes.items() if ndim == 3} == own[shared]


def _layers(params):
    """A dense layer of each part of the model."""
    parts = params["params"]
    return {
        "encoder": parts["encoder"]["encoders_vector"]["Dense_0"],
        "memory": parts["memory"]["input"],
        "actor": parts["actor"]["Dense_0"],
        "critic": parts["critic"],
    }


def inputs(model, lanes=3, steps=4):
    pomdp = crowd(2)
    space = pomdp.observation_space.spaces["vector"]
    keys = jax.random.split(jax.random.key(0), steps * lanes)
    vector = jax.vmap(space.sample)(keys).reshape(steps, lanes, 2, -1)
    action = jax.vmap(pomdp.action_space.sample)(keys).reshape(steps, lanes, 2)
    first = jnp.zeros((steps, lanes), bool).at[2, 1].set(True)
    return {"vector": vector}, model.initial_memory(lanes), action, first


def swapped(tree, axis):
    return jax.tree.map(lambda x: jnp.flip(x, axis), tree)


@pytest.mark.parametrize("shared", ["all", "body", "nothing"])
def test_a_sequence_is_its_steps_for_every_agent(shared):
    space = crowd(2).action_space
    model = AgentsActorCritic(space, ENCODER, GRU(8), shared, previous_action=True)
    observation, memory, action, first = inputs(model)
    params = model.init(jax.random.key(1), observation, memory, action, first)
    whole, last = model.apply(params, observation, memory, action, first)
    for t in range(first.shape[0]):
        now = {"vector": observation["vector"][t]}
        output, memory = model.apply(params, now, memory, action[t], first[t])
        chex.assert_trees_all_close(
            (output.distribution, output.value),
            jax.tree.map(lambda x, t=t: x[t], (whole.distribution, whole.value)),
            atol=1e-5,
        )
    chex.assert_trees_all_close(memory, last, atol=1e-5)


def test_with_parameters_in_common_agents_are_alike_unless_told_apart():
    space = crowd(2).action_space
    for identity in (False, True):
        model = AgentsActorCritic(space, ENCODER, GRU(8), identity=identity)
        given = inputs(model)
        params = model.init(jax.random.key(1), *given)
        value = model.apply(params, *given)[0].value
        observation, memory, action, first = given
        turned = (swapped(observation, 2), memory, swapped(action, 2), first)
        other = swapped(model.apply(params, *turned)[0].value, 2)
        assert bool(jnp.allclose(value, other, atol=1e-5)) is not identity


@pytest.mark.parametrize("central", [False, True])
def test_only_a_central_critic_sees_the_others_and_no_actor_does(central):
    space = crowd(2).action_space
    model = AgentsActorCritic(space, ENCODER, GRU(8), central_critic=central)
    observation, *rest = inputs(model)
    params = model.init(jax.random.key(1), observation, *rest)

    def of_first(vector):
        output, _ = model.apply(params, {"vector": vector}, *rest)
        return output.value[..., 0].sum(), output.distribution.logits[..., 0, :].sum()

    value, actor = jax.jacrev(of_first)(observation["vector"])
    assert bool(jnp.any(value[:, :, 1] != 0)) is central
    assert not bool(jnp.any(actor[:, :, 1] != 0))
    assert bool(jnp.any(actor[:, :, 0] != 0))


def test_rewards_are_mixed():
    pomdp = crowd(2)
    cells, goals = jnp.int32([4, 1]), jnp.int32([5, 0])
    action = jnp.int32([1, 1])

    def rewards(own, others):
        mixed = dataclasses.replace(pomdp, task=MixedRewards(ReachEnds(), own, others))
        state = mixed.begin(dataclasses.replace(episode, environment=cells, task=goals))
        _, step = mixed.step(jax.random.key(0), state, action)
        return step.reward, step.reward_terms["success"]

    episode = pomdp.sampler.sample(jax.random.key(0), ())
    np.testing.assert_allclose(rewards(1.0, 0.0)[0], [0.99, -0.01], rtol=1e-5)
    np.testing.assert_allclose(rewards(1.0, 1.0)[1], [1.0, 1.0])
    np.testing.assert_allclose(rewards(1.0, 0.25)[0], [0.9875, 0.2375], rtol=1e-5)
    np.testing.assert_allclose(rewards(0.0, 1.0)[1], [0.0, 1.0])


def test_mixing_gives_no_task_an_expert_and_takes_none_away():
    for pomdp, has in ((envs_jax.make("Markov-StagHunt-v0"), False), (crowd(2), True)):
        mixed = dataclasses.replace(pomdp, task=MixedRewards(pomdp.task, others=1.0))
        assert mixed.has_expert is has
        again = dataclasses.replace(mixed, task=dataclasses.replace(mixed.task, own=0.5))
        assert again.has_expert is has


def test_rewards_of_one_are_not_mixed():
    alone = corridor(length=6)
    with pytest.raises(JaxactError, match="a world of one without an axis of agents"):
        dataclasses.replace(alone, task=MixedRewards(alone.task))


def test_one_reading_for_all():
    sensor = ForAll(CellAndGoal(), 3)
    reading = sensor.observe(jnp.int32(2), jnp.int32(5))
    assert reading.shape == sensor.space.structure.shape == (3, 12)
    assert bool(jnp.all(reading == reading[0]))


def test_lanes_of_agents_and_back():
    x = jnp.arange(2 * 3 * 4 * 5).reshape(2, 3, 4, 5)
    assert as_lanes(x, 2).shape == (2, 12, 5)
    np.testing.assert_array_equal(as_agents(as_lanes(x, 2), 2, 4), x)
    np.testing.assert_array_equal(as_agents(as_lanes(x[0], 1), 1, 4), x[0])


def test_what_does_not_fit_together_is_refused():
    pomdp = crowd(2)
    with pytest.raises(JaxactError, match=r"'vector' must have a reading for each of 2 agent\(s\)"):
        dataclasses.replace(pomdp, sensors={"vector": CellAndGoal()})
    with pytest.raises(JaxactError, match=r"for each of 1 agent\(s\)"):
        dataclasses.replace(corridor(), sensors=pomdp.sensors)
    stages = (Stage({"ppo": PPO()}, 64),)
    single = ActorCritic(Discrete(2), ENCODER, GRU(8))
    with pytest.raises(JaxactError, match="AgentsActorCritic"):
        train(experiment(pomdp, single, stages))
    wrong = AgentsActorCritic(Agents(Discrete(2), 3), ENCODER, GRU(8))
    with pytest.raises(JaxactError, match="count=3"):
        train(experiment(pomdp, wrong, stages))
    for refused in (
        lambda: to_gymnasium(pomdp),
        lambda: to_gymnax(pomdp),
        lambda: collect(pomdp, "nowhere", 1, world="crowd"),
    ):
        with pytest.raises(JaxactError, match="for worlds of one agent, and this one is of 2"):
            refused()
    with pytest.raises(JaxactError, match="unknown way of sharing parameters 'al'"):
        train(of_crowd(2, stages, "al"))


def with_loss(pomdp, model, loss):
    return experiment(pomdp, model, (Stage({"ppo": PPO(), "other": loss}, 64),))


def test_models_of_one_agent_and_of_several_are_not_taken_for_each_other():
    pomdp, alone = crowd(2), corridor()
    for model in (ActorCritic, QNetwork):
        with pytest.raises(JaxactError, match=f"{model.__name__} chooses for one .* 2 agents: use"):
            with_loss(pomdp, model(pomdp.action_space, ENCODER), PPO()).check()
    for space in (pomdp.action_space, alone.action_space):
        with pytest.raises(JaxactError, match=r"AgentsActorCritic .*: use ActorCritic"):
            with_loss(alone, AgentsActorCritic(space, ENCODER), PPO()).check()


@pytest.mark.parametrize(
    ("loss", "sentence"),
    [
        (InverseDynamics(action_space=Agents(Discrete(2), 2)), "each agent's is Discrete"),
        (PQN(), "such as QNetwork; AgentsActorCritic has none, so leave one agent with jaxact.opp"),
        (AdvisorImitation(), "compares two actors; .*; AgentsActorCritic has none"),
        (
            RandomNetworkDistillation(encoder=ENCODER),
            "of 2 agents; jaxact.opponents.against leaves",
        ),
        (Cordial(), "unknown reading 'coordination'; the nearest is 'vector'"),
        (Cordial("vector"), r"\[2, 2\] for each of 2 agents, and is \[12\]"),
    ],
    ids=lambda x: type(x).__name__,
)
def test_losses_that_cannot_be_agents_are_refused(loss, sentence):
    pomdp = crowd(2)
    model = AgentsActorCritic(pomdp.action_space, ENCODER, GRU(8))
    with pytest.raises(JaxactError, match=sentence):
        with_loss(pomdp, model, loss).check()


def test_losses_with_heads_of_their_own_are_of_each_agent():
    pomdp = crowd(3)
    model = AgentsActorCritic(pomdp.action_space, ENCODER, GRU(8))
    small = with_loss(pomdp, model, InverseDynamics(action_space=pomdp.action_space.space))
    _, metrics = jax.eval_shape(make_train(small), jax.random.key(0))
    assert "losses/other/cross_entropy" in metrics


def test_teams_choose_from_the_worlds_actions():
    alone, pomdp = corridor(), crowd(3)
    for actor in (CentralActor(4), SyncActor(4, 2)):
        model = AgentsActorCritic(pomdp.action_space, ENCODER, GRU(8), team_actor=actor)
        with pytest.raises(
            JaxactError, match=r"from 4 actions of each agent, .* give it actions=2"
        ):
            with_loss(pomdp, model, PPO()).check()
    single = ActorCritic(alone.action_space, ENCODER)
    with pytest.raises(JaxactError, match="Cordial is for worlds of several agents"):
        with_loss(alone, single, Cordial()).check()


@pytest.mark.slow
def test_a_crowd_resumed_is_the_crowd_that_was_never_stopped(tmp_path):
    small = of_crowd(3, (Stage({"a2c": A2C()}, 4 * UPDATE),), "body")
    whole = jaxact.train(small, output=tmp_path, **OPTIONS)
    copy = shutil.copytree(whole.run, tmp_path / "copy")
    for path in (copy / "checkpoints").iterdir():
        if int(path.name) > 2 * UPDATE:
            shutil.rmtree(path)
    resumed = jaxact.train(small, resume=copy, **OPTIONS)
    assert resumed.metrics["step"].tolist() == [3 * UPDATE, 4 * UPDATE]
    assert_same(resumed.state, whole.state)
    assert (copy / "metrics.jsonl").read_bytes() == (whole.run / "metrics.jsonl").read_bytes()


@pytest.mark.slow
def test_crowds_are_swept(tmp_path):
    space = {"pipeline.learning_rate": choice(1e-2, 1e-3)}
    settings = {"draws": 2, "evaluations": 1, "evaluation_episodes": 8, "progress": False}
    small = of_crowd(2, (Stage({"ppo": PPO()}, 2 * UPDATE),))
    found = jaxact.sweep(small, space, output=tmp_path, **settings)
    assert len(found.records) == 2
    for record in found.records:
        last = record["evaluations"][-1]
        each = [last[f"agents/{i}/return"] for i in range(2)]
        np.testing.assert_allclose(np.mean(each), last["return"], rtol=1e-4)


def test_films_show_every_agents_policy():
    pomdp = envs_jax.make("Markov-StagHunt-v0")
    encoder = Concatenated({"map": Flat()})
    model = AgentsActorCritic(pomdp.action_space, encoder, GRU(4))
    observation = jax.tree.map(lambda x: x[None], pomdp.observation_space.zeros())
    params = model.init(
        jax.random.key(0), observation, model.initial_memory(1), jnp.zeros((1, 2), jnp.int32),
        jnp.ones(1, bool),
    )  # fmt: skip
    film = record_episode(pomdp, Policy(model, params, pomdp.action_space), max_steps=2)
    assert film.shape[0] == 2
    panel = {"value": 0.0, "reward": 0.0, "episode_return": 0.0, "step": 0, "mission": None}
    heights = [
        annotate(
            np.zeros((120, 120, 3), np.uint8),
            action_names=["x"] * bars,
            action_probabilities=[0.5] * bars,
            chosen=[0],
            **panel,
        ).shape[0]
        for bars in (4, 8)
    ]
    assert film.shape[1] == heights[1] > heights[0]
