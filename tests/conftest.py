"""All tests run under JAX's strict promotion of dtypes, and compile quickly.

They compile far more than they compute, so XLA is told not to optimise, and programs are kept in a
compilation cache for as long as the tests run: for both workers and the processes that they start.
"""

import atexit
import os
import shutil
import tempfile

import jax
import pytest

_FAST = (
    "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 "
    # Two workers keep two cores busy: more threads only cost time.
    "--xla_cpu_parallel_codegen_split_count=1"
)
# Read when JAX first computes something, here and in the processes that tests start.
os.environ.setdefault("XLA_FLAGS", _FAST)

if "PYTEST_XDIST_WORKER" not in os.environ:
    _DIRECTORY = tempfile.mkdtemp(prefix="jaxact-tests-")
    atexit.register(shutil.rmtree, _DIRECTORY, ignore_errors=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _DIRECTORY
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "0"
# The environment is for other processes: in this one JAX may have been imported before.
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
jax.config.update("jax_numpy_dtype_promotion", "strict")

# They are the longest, and so must not be the last to begin.
_LONG = ("test_notebook.py", "test_readme.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in _LONG)
