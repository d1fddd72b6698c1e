"""Schedules at, between and beyond their end points."""

import jax.numpy as jnp
import pytest

from jaxact.schedules import Cosine, Linear, Piecewise, value_at


@pytest.mark.parametrize(
    ("schedule", "expected"),
    [
        (Linear(1.0, 0.0, 100.0), {0: 1.0, 25: 0.75, 100: 0.0, 500: 0.0}),
        (Cosine(1.0, 0.0, 100.0), {0: 1.0, 50: 0.5, 100: 0.0, 500: 0.0}),
        (Piecewise((10.0, 20.0), (1.0, 2.0, 3.0)), {0: 1.0, 10: 2.0, 19: 2.0, 20: 3.0, 99: 3.0}),
        (0.3, {0: 0.3, 99: 0.3}),
        (lambda steps: steps * 2, {0: 0.0, 3: 6.0}),
    ],
)
def test_values(schedule, expected):
    for steps, value in expected.items():
        got = value_at(schedule, jnp.float32(steps))
        assert got.dtype == jnp.float32
        assert float(got) == pytest.approx(value, abs=1e-6)


def test_piecewise_needs_one_value_more():
    with pytest.raises(ValueError, match="one value more"):
        Piecewise((1.0,), (1.0,))
