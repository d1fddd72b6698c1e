import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.multiply_high import multiply_high


@pytest.mark.parametrize("dtype", ["uint32", "int32"])
def test_the_upper_half_of_products_is_exact(dtype):
    rng, info = np.random.default_rng(0), np.iinfo(dtype)
    borders = np.array([info.min, info.min + 1, 0, 1, info.max - 1, info.max, 65535, 65536])
    x = np.concatenate([np.repeat(borders, 8), rng.integers(info.min, info.max, 1000)])
    y = np.concatenate([np.tile(borders, 8), rng.integers(info.min, info.max, 1000)])
    expected = [int(a) * int(b) >> 32 for a, b in zip(x, y, strict=True)]
    x, y = jnp.asarray(x.astype(dtype)), jnp.asarray(y.astype(dtype))
    high = jax.jit(multiply_high)(x, y)
    assert high.dtype == dtype
    assert np.asarray(high).tolist() == expected
    np.testing.assert_array_equal(high, jax.lax.mulhi(x, y))
