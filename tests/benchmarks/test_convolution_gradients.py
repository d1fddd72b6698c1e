"""The benchmark of convolutions' gradients times the same work under both names."""

import jax
import numpy as np
import pytest

from benchmarks import convolution_gradients
from benchmarks.convolution_gradients import Arguments, Shape, measure, measure_shape
from jaxact.errors import JaxactError


def test_a_shape_has_a_line_for_each_system_and_their_ratio():
    *systems, ratio = measure_shape(Shape(6, 2, 3, 2, 4), Arguments(images=2, steps=1, repeats=2))
    assert [x["system"] for x in systems] == ["jaxact", "xla"]
    for line in systems:
        assert 0 < line["microseconds_per_image"] <= line["microseconds_per_image_median"]
    ours, xla = (x["microseconds_per_image"] for x in systems)
    assert ratio["ratio"] == pytest.approx(xla / ours, rel=0.05)


def test_both_systems_end_with_the_same_numbers():
    inputs = [
        jax.random.normal(jax.random.key(i), x) for i, x in enumerate([(3, 7, 7, 2), (3, 3, 2, 4)])
    ]
    ends = [
        convolution_gradients._scan(convolution, 2, 3)(*inputs)
        for convolution in (convolution_gradients.convolve, convolution_gradients._convolve_by_xla)
    ]
    for ours, xla, begun in zip(*ends, inputs, strict=True):
        np.testing.assert_allclose(ours - begun, xla - begun, rtol=1e-2, atol=1e-6)
        assert np.abs(xla - begun).max() > 1e-5


def test_numbers_that_cannot_be_are_refused():
    with pytest.raises(JaxactError, match="--steps must be at least 1; got 0"):
        measure(Arguments(steps=0))
