"""All tests run under JAX's strict promotion of dtypes."""

import jax

jax.config.update("jax_numpy_dtype_promotion", "strict")
