"""The environment over any MJCF model: actions, sensors, what goes wrong."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs_jax.physics import BodySensor, JointSensor, ModelSensor, NoisyStart, Physics
from envs_jax.physics.locomotion import Balance, RunUpright
from jaxact import Experiment, Stage, TrainingPipeline, train
from jaxact.checkpoints import Checkpoints
from jaxact.errors import JaxactError
from jaxact.losses import PPO
from jaxact.models import ActorCritic, Concatenated, NoMemory
from jaxact.pomdp import POMDP
from tests.tiny import Plain

# A ball in a slide over a floor, with all that a model can sense of it.
BALL = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom type="plane" size="2 2 1"/>
    <body name="ball" pos="0 0 0.5">
      <joint name="up" type="slide" axis="0 0 1"/>
      <joint name="along" type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.1" mass="1"/>
      <site name="middle"/>
      <site name="skin" size="0.11"/>
      <site name="down" xyaxes="1 0 0 0 -1 0"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="lift" joint="up" ctrlrange="0 30"/>
    <motor name="push" joint="along" ctrlrange="-2 2"/>
  </actuator>
  <sensor>
    <accelerometer name="felt" site="middle"/>
    <touch name="touch" site="skin"/>
    <rangefinder name="height" site="down"/>
  </sensor>
</mujoco>
"""
WORLD = Physics(BALL, substeps=2, extras=("cfrc_ext", "subtree_com"))
step = jax.jit(WORLD.step)
KEY = jax.random.key(0)


@pytest.fixture(scope="module")
def start():
    return jax.jit(WORLD.start)(jnp.zeros(2, jnp.float32), jnp.zeros(2, jnp.float32))


def run(state, action, count):
    for _ in range(count):
        state = step(KEY, state, jnp.asarray(action, jnp.float32))
    return state


def test_actions_are_stretched_to_the_ranges_of_their_actuators():
    assert (WORLD.action_space.low, WORLD.action_space.high) == (-1, 1)
    for action, controls in (([-1, -1], [0, -2]), ([0, 0], [15, 0]), ([5, 1], [30, 2])):
        np.testing.assert_allclose(WORLD.controls(jnp.float32(action)), controls)
    alike = Physics(BALL.replace("0 30", "-2 2"))
    assert (alike.action_space.low, alike.action_space.high) == (-2, 2)
    np.testing.assert_allclose(alike.controls(jnp.float32([1.5, -9])), [1.5, -2])


def test_what_falls_falls_as_newton_says(start):
    # 0.2 s without lift, and pushed by 2 N along: half of the pull of the floor is not yet felt.
    state = run(start, [-1, 1], 10)
    assert float(state.time) == pytest.approx(0.2)
    # Euler's rule: velocities first, then places; in steps of 10 ms.
    np.testing.assert_allclose(state.velocity, [-9.81 * 0.2, 0.4], rtol=1e-5)
    np.testing.assert_allclose(state.position, [-9.81 * 0.021, 2 * 0.021], rtol=1e-4)


def test_sensors_read_what_the_model_measures(start):
    joints, body = JointSensor(WORLD, skip=1, fastest=1.0), BodySensor(WORLD, "ball")
    felt, touch, height = (ModelSensor(WORLD, name) for name in ("felt", "touch", "height"))
    assert [s.space.shape for s in (joints, body, felt, touch, height)] == [
        (3,),
        (7,),
        (3,),
        (1,),
        (1,),
    ]
    np.testing.assert_allclose(felt.observe(start, None), 0, atol=1e-5)
    np.testing.assert_allclose(height.observe(start, None), 0.5, atol=1e-5)
    falling = run(start, [-1, 1], 10)
    np.testing.assert_allclose(joints.observe(falling, None), [0.042, -1, 0.4], rtol=1e-4)
    turned = JointSensor(WORLD, skip=1, on_circle=True)
    assert turned.space.shape == (4,)
    expected = [np.cos(0.042), np.sin(0.042), -9.81 * 0.2, 0.4]
    np.testing.assert_allclose(turned.observe(falling, None), expected, rtol=1e-4)
    np.testing.assert_allclose(touch.observe(falling, None), 0)
    lying = run(falling, [-1, 0], 60)
    np.testing.assert_allclose(body.observe(lying, None)[2:], [0.1, 1, 0, 0, 0], atol=5e-3)
    # At rest the floor carries it.
    np.testing.assert_allclose(touch.observe(lying, None), 9.81, rtol=1e-2)
    np.testing.assert_allclose(felt.observe(lying, None)[2], 9.81, rtol=1e-2)
    np.testing.assert_array_equal(start.extras["cfrc_ext"], np.zeros((2, 6)))
    np.testing.assert_allclose(lying.extras["cfrc_ext"][1, 5], 9.81, rtol=1e-2)
    center = lying.extras["subtree_com"]
    np.testing.assert_allclose(center, np.stack([lying.body_position[1]] * 2), atol=1e-6)


def test_a_simulation_that_comes_apart_ends_the_episode_where_it_was_sound(start):
    pomdp = POMDP(WORLD, Balance(lean=9.0), NoisyStart(WORLD, 0.0, 0.0), {"x": JointSensor(WORLD)})
    state, _ = jax.jit(pomdp.reset)(KEY)
    broken = jax.tree.map(lambda x: x, state)
    object.__setattr__(broken.environment, "velocity", jnp.float32([jnp.nan, 0]))
    after, result = jax.jit(pomdp.step)(KEY, broken, jnp.zeros(2, jnp.float32))
    assert bool(result.terminated)
    assert float(result.metrics["diverged"]) == 1
    assert np.isfinite(float(result.reward))
    np.testing.assert_array_equal(after.environment.position, state.environment.position)


@pytest.mark.slow
def test_training_goes_on_where_simulations_come_apart(tmp_path):
    """A motor that tears the ball away in each episode's first step: episodes end, and no loss."""
    source = BALL[: BALL.index("<sensor>")] + "</mujoco>"
    source = source.replace('joint="along" ctrlrange', 'joint="along" gear="1e30" ctrlrange')
    world = Physics(source)
    sensors = {"x": JointSensor(world)}
    pomdp = POMDP(world, Balance(lean=9.0), NoisyStart(world, 0.1, 0.1), sensors)
    model = ActorCritic(pomdp.action_space, Concatenated({"x": Plain()}), NoMemory())
    pipeline = TrainingPipeline(
        (Stage({"ppo": PPO()}, steps=64),), lanes=4, rollout_length=4, epochs=1, minibatches=1
    )
    result = train(
        Experiment("apart", pomdp, model, pipeline), output=tmp_path, log_every=16,
        checkpoint_every=32, evaluation_episodes=4, progress=False,
    )  # fmt: skip
    assert result.evaluation.metrics["task/diverged"].tolist() == [1] * 4
    assert result.evaluation.length.tolist() == [1] * 4
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(result.policy.params))
    assert Checkpoints(result.run / "checkpoints").steps() == [32, 64]


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("no/such.xml", "there is no file 'no/such.xml'"),
        ("<mujoco><worldbody>", "MuJoCo cannot read this MJCF: XML parse error"),
        (
            '<mujoco><asset><mesh name="m" file="gone.stl"/></asset></mujoco>',
            "cannot read this MJCF: .*gone.stl",
        ),
        ("<mujoco/>", "no actuators"),
        (BALL.replace(' ctrlrange="-2 2"', ""), r"'push' \(number 1\) has no ctrlrange"),
        (BALL.replace('timestep="0.01"', 'timestep="0"'), "timestep is 0.0, and has to be above 0"),
        (None, "needs an MJCF file's path, or its text, not None"),
        (BALL.replace('timestep="0.01"', 'integrator="implicit"'), "MJX cannot simulate"),
    ],
)
def test_models_that_cannot_be_are_refused_with_a_sentence(source, message):
    with pytest.raises(JaxactError, match=message):
        Physics(source)


def test_names_that_the_model_lacks_are_refused():
    with pytest.raises(JaxactError, match="unknown body of the model 'bal'; the nearest is 'ball'"):
        BodySensor(WORLD, "bal")
    with pytest.raises(JaxactError, match=r"unknown sensor of the model 'tuch'.*'touch'"):
        ModelSensor(WORLD, "tuch")
    with pytest.raises(JaxactError, match="substeps of a physics world must be at least 1, got 0"):
        Physics(BALL, substeps=0)
    with pytest.raises(
        JaxactError, match="substeps of a physics world must be a whole number, got"
    ):
        Physics(BALL, substeps=1.5)
    with pytest.raises(JaxactError, match=r"a class of envs_jax.physics.Controller, not 'moves'"):
        Physics(BALL, controller="moves")
    with pytest.raises(JaxactError, match="kind of a model's parts 'bdy'; the nearest is 'body'"):
        WORLD.index("bdy", "ball")
    with pytest.raises(JaxactError, match="horizon of a noisy start's episodes must be at least 1"):
        NoisyStart(WORLD, 0.0, 0.0, horizon=0)


def test_what_is_not_kept_is_not_read():
    with pytest.raises(JaxactError, match="of MuJoCo's data 'cfrc'; the nearest is 'cfrc_ext'"):
        Physics(BALL, extras=("cfrc",))
    with pytest.raises(JaxactError, match="RunUpright reads 'cfrc_ext', which its world does not"):
        RunUpright(Physics(BALL), 1.0, height=(0.0, 1.0))
    world = Physics(BALL, extras=("cfrc_ext",))
    with pytest.raises(JaxactError, match="RunUpright reads 'subtree_com', which its world does"):
        RunUpright(world, 1.0, height=(0.0, 1.0), whole=True)


def test_numbers_that_the_model_has_no_joints_or_actuators_for_are_refused():
    two, three = jnp.zeros(2, jnp.float32), jnp.zeros(3, jnp.float32)
    with pytest.raises(
        JaxactError, match=r"velocity in this model has the shape \(2,\), not \(3,\)"
    ):
        jax.eval_shape(WORLD.start, two, three)
    with pytest.raises(
        JaxactError, match=r"the action in this model has the shape \(2,\), not \(3,\)"
    ):
        jax.eval_shape(WORLD.step, KEY, jax.eval_shape(WORLD.start, two, two), three)


def test_a_model_may_be_a_path_or_begin_with_the_mark_of_its_byte_order(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(BALL)
    assert Physics(path).source == str(path)
    assert Physics("\ufeff" + BALL).model.nu == 2
