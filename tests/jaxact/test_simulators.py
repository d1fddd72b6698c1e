"""Which simulator plays which episode, without any program."""

import jax
import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.simulator_hosts import LocalHost, Reading
from jaxact.simulators import (
    EPISODE,
    HORIZON,
    SIMULATOR,
    STEPS,
    TERMINATED,
    WIDTH,
    Simulators,
    seed_of,
)


class Counter:
    """Says the seed it was reset to and the sum of its actions; it terminates at 100."""

    made = 0

    def __init__(self):
        Counter.made += 1
        self.is_closed = False

    def reset(self, seed):
        self.seed, self.total = seed, 0
        return self._reading()

    def step(self, action):
        self.total += int(action[0])
        return self._reading()

    def close(self):
        self.is_closed = True

    def _reading(self):
        seen = np.array([self.seed, self.total], np.int32)
        return Reading((seen,), np.array([0, self.total >= 100, 0, -1], np.float32))


def pool(limit, threads=0):
    Counter.made = 0
    shapes = [jax.ShapeDtypeStruct((2,), np.int32)]
    return Simulators(LocalHost(Counter, threads), limit, shapes, 0)


def tickets(*episodes, horizon=10):
    made = np.zeros((len(episodes), WIDTH), np.uint32)
    made[:, EPISODE] = [(2 * episode, 7) for episode in episodes]
    made[:, HORIZON] = horizon
    return made


def begun(simulators, made):
    rows, _, seen = simulators.begin(made)
    made[:, SIMULATOR] = rows
    np.testing.assert_array_equal(seen[:, 0], seed_of(made[:, EPISODE]))
    return made


def stepped(simulators, made, actions, active=None):
    active = np.ones(len(made), bool) if active is None else np.asarray(active)
    numbers, seen = simulators.step(made, active, np.asarray(actions, np.int32))
    made[:, STEPS] += 1
    return numbers, seen[:, 1].tolist()


@pytest.mark.parametrize("threads", [0, 2])
def test_each_episode_has_a_simulator_of_its_own(threads):
    simulators = pool(3, threads)
    made = begun(simulators, tickets(5, 6, 7))
    assert sorted(made[:, SIMULATOR].tolist()) == [0, 1, 2]
    assert stepped(simulators, made, [1, 2, 3])[1] == [1, 2, 3]
    assert stepped(simulators, made[::-1], [4, 5, 6])[1] == [7, 7, 7]
    assert stepped(simulators, made, [1, 1, 1], [True, False, True])[1] == [8, 0, 8]
    simulators.close()


def test_what_is_asked_for_twice_is_begun_once():
    simulators = pool(8)
    made = begun(simulators, tickets(1, 2, 1, 1))
    assert Counter.made == 2
    assert made[0, SIMULATOR] == made[2, SIMULATOR] == made[3, SIMULATOR]
    again = begun(simulators, tickets(1))
    assert again[0, SIMULATOR] == made[0, SIMULATOR]
    stepped(simulators, again, [3])
    anew = begun(simulators, tickets(1))
    assert stepped(simulators, anew, [4])[1] == [4]
    assert Counter.made == 2


def test_simulators_that_are_done_play_the_next_episodes():
    simulators = pool(2)
    made = begun(simulators, tickets(1, 2))
    numbers, _ = stepped(simulators, made, [0, 100])
    assert numbers[:, TERMINATED].tolist() == [0, 1]
    (following,) = begun(simulators, tickets(3))
    assert following[SIMULATOR] == made[1, SIMULATOR]
    late = begun(pool(2), tickets(1, 2, horizon=1))
    assert len(late) == 2


def test_a_horizon_frees_a_simulator():
    simulators = pool(2)
    made = begun(simulators, np.concatenate([tickets(1), tickets(2, horizon=1)]))
    stepped(simulators, made, [1, 1])
    (following,) = begun(simulators, tickets(3))
    assert following[SIMULATOR] == made[1, SIMULATOR]
    assert stepped(simulators, made[:1], [1])[1] == [2]


def test_the_longest_idle_episode_is_given_up():
    """As those of lanes that are no longer there."""
    simulators = pool(2)
    old = begun(simulators, tickets(1, 2))
    stepped(simulators, old[1:], [1])
    begun(simulators, tickets(3))
    assert stepped(simulators, old[1:], [1])[1] == [2]
    with pytest.raises(JaxactError, match=r"at step 0 .* seed 1 .* no simulator is playing"):
        stepped(simulators, old[:1], [1])
    with pytest.raises(JaxactError, match="than there are simulators, 2"):
        simulators.begin(tickets(4, 5, 6))


def test_a_simulator_that_fails_is_replaced():
    simulators = pool(1)
    made = begun(simulators, tickets(1))
    with pytest.raises(JaxactError, match="at step 0 of the episode with seed 1: ValueError: inv"):
        simulators.step(made, np.ones(1, bool), np.array(["x"]))
    with pytest.raises(JaxactError, match="no simulator is playing its episode"):
        stepped(simulators, made, [1])
    begun(simulators, tickets(1))
    assert Counter.made == 2
