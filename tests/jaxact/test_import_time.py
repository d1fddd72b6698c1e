"""`import jaxact` stays quick; it and the worlds leave the heavy libraries alone."""

import os
import subprocess
import sys
from pathlib import Path

HEAVY = ("flax", "orbax", "tensorboardX", "brax", "mujoco", "optax", "matplotlib", "imageio")
PRINT = """
import sys, time, jaxact
dir(jaxact)
seconds = time.process_time()
import envs_jax
print(seconds, *sys.modules)
"""
SECONDS = 2.5


def start():
    """Returns the processor's time, whatever else the machine does, and the loaded modules."""
    ended = subprocess.run(
        [sys.executable, "-c", PRINT],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=True,
    )
    seconds, *modules = ended.stdout.split()
    return float(seconds), set(modules)


def test_import_is_quick_and_light():
    seconds, modules = start()
    assert modules.isdisjoint(HEAVY)
    # The fastest of three counts, but what was quick enough need not be repeated.
    for _ in range(2):
        if seconds >= SECONDS:
            seconds, _ = start()
    assert seconds < SECONDS
