"""Draws are pure, follow their ranges, and what cannot be drawn is told in a sentence."""

import numpy as np
import pytest
from scipy import stats

from jaxact import JaxactError
from jaxact.search_space import SearchSpace, choice, in_order, log_uniform, normal, uniform
from tests.tiny import experiment

RATE, CLIP = "pipeline.learning_rate.start", "pipeline.stages.1.losses.ppo.clip"
FORCING = "pipeline.stages.0.teacher_forcing"


def drawn(value, path=RATE, count=4000):
    space = SearchSpace.of({path: value})
    return np.array([space.draw(0, index)[path] for index in range(count)])


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
        (log_uniform(1e-4, 0.5), stats.loguniform(1e-4, 0.5)),
        (normal(2.0, 3.0), stats.norm(2.0, 3.0)),
    ],
)
def test_draws_follow_their_range(value, expected):
    assert stats.kstest(drawn(value), expected.cdf).pvalue > 0.01


def test_choices_are_equally_likely():
    values, counts = np.unique(drawn(choice(4, 8, 16, 32)), return_counts=True)
    assert values.tolist() == [4.0, 8.0, 16.0, 32.0]
    assert stats.chisquare(counts).pvalue > 0.01


def test_values_in_order_are_taken_one_after_the_other_and_again():
    assert drawn(in_order(3, 1, 2, 7, 5), count=7).tolist() == [3.0, 1.0, 2.0, 7.0, 5.0, 3.0, 1.0]


def test_a_draw_depends_on_seed_index_and_path_alone():
    one = SearchSpace.of({RATE: uniform(0, 1)})
    two = SearchSpace.of({CLIP: uniform(0, 1), RATE: uniform(0, 1)})
    assert one.draw(3, 7)[RATE] == two.draw(3, 7)[RATE]
    values = {two.draw(seed, i)[path] for seed in (0, 1) for i in (0, 1) for path in (RATE, CLIP)}
    assert len(values) == 8


def test_paths_of_one_key_share_a_draw():
    both = (f"{FORCING}.steps", "pipeline.learning_rate.steps")
    space = SearchSpace.of({both: uniform(64, 256)})
    first = space.draw(0, 0)
    assert first.keys() == set(both)
    assert len(set(first.values())) == 1


def test_text_reads_back():
    texts = (
        f"{RATE}=log_uniform(1e-4, 5e-1)",
        f"{CLIP} = choice(0.1,0.2)",
        f"{FORCING}.steps,pipeline.learning_rate.steps=uniform(1,2)",
    )
    space = SearchSpace.parse(texts)
    assert space.ranges[(RATE,)] == log_uniform(1e-4, 0.5)
    assert space.ranges[(CLIP,)] == choice(0.1, 0.2)
    assert SearchSpace.parse(f"{k}={v}" for k, v in space.to_texts().items()) == space
    space.check(experiment())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected path=range, for example"),
        ("a", "expected path=range, for example"),
        ("a=3", "a: expected a range such as log_uniform"),
        ("a=uniform(x,1)", "a: expected numbers in uniform"),
        ("a=unifrom(0,1)", "unknown range 'unifrom'; the nearest is 'uniform'"),
        ("a=uniform(0)", "expected two numbers, got 1"),
        ("a=uniform(1,0)", "the lower end must be below"),
        ("a=log_uniform(0,1)", "the lower end must be positive"),
        ("a=normal(0,0)", "the deviation must be positive"),
        ("a=uniform(0,inf)", "expected finite numbers"),
        ("a=choice()", "needs at least one value"),
        ("a,a=uniform(0,1)", "a is drawn twice"),
    ],
)
def test_ranges_that_mean_nothing(text, message):
    with pytest.raises(JaxactError, match=message):
        SearchSpace.parse([text])


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("pipeline.learning_rate.strat", r"unknown number .*nearest is 'pipeline.learning_rate.st"),
        ("pipeline.learning_rate", r"is a whole part; draw a number of it: .*learning_rate.start"),
        ("pipeline.lanes", r"pipeline.lanes is 8, and only floats outside of the model can be"),
        (
            "model.memory.size",
            r"model.memory.size is 8, and only floats outside of the model can be",
        ),
        ("pipeline.stages.0.steps", r"steps is 256, and only floats.*nearest is"),
    ],
)
def test_what_is_no_number_of_the_experiment(path, message):
    with pytest.raises(JaxactError, match=message):
        SearchSpace.of({path: uniform(0, 1)}).check(experiment())


def test_a_space_needs_ranges():
    with pytest.raises(JaxactError, match="at least one number to draw"):
        SearchSpace.of({})
    with pytest.raises(JaxactError, match=r"expected a range such as .* but got 0.5"):
        SearchSpace.of({RATE: 0.5})
    with pytest.raises(JaxactError, match="is drawn twice"):
        SearchSpace.of({RATE: uniform(0, 1), (RATE, CLIP): uniform(0, 1)})
