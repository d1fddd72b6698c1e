"""MJCF models, compiled by MuJoCo and put on the device by MJX.

Importing MuJoCo's Python packages takes seconds, so it is left until a world is built.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import io
import logging
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact.errors import JaxactError, unknown


@functools.cache
def mjx() -> Any:
    """Returns the module `mujoco.mjx`."""
    # It prints what of NVIDIA's backend is not installed.
    with contextlib.redirect_stdout(io.StringIO()):
        from mujoco import mjx
    return mjx


@functools.cache
def host_model(source: str) -> Any:
    """Compiles a model.

    Args:
      source: a path of an MJCF file, or its text.

    Returns:
      The `mujoco.MjModel`.

    Raises:
      JaxactError: there is no such file, or MuJoCo cannot read it or what it refers to.
    """
    import mujoco

    # Some editors begin a file with a mark of its byte order, and MuJoCo does not read it.
    is_text = source.lstrip("\ufeff \t\r\n").startswith("<")
    if not is_text and not Path(source).is_file():
        raise JaxactError(
            f"there is no file {source!r}: a physics world needs an MJCF file's path, or its text"
        )
    read = mujoco.MjModel.from_xml_string if is_text else mujoco.MjModel.from_xml_path
    source = source.removeprefix("\ufeff")
    # Its own way of warning is to write a file into the working directory.
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(logging.getLogger("mujoco").warning)
    try:
        return read(source)
    except ValueError as error:
        reason = " ".join(str(error).split())
        name = "this MJCF" if is_text else f"{source!r}"
        raise JaxactError(f"MuJoCo cannot read {name}: {reason}") from error
    finally:
        mujoco.set_mju_user_warning(before)


@functools.cache
def device_model(source: str) -> Any:
    """Returns the `mujoco.mjx.Model` of `host_model`, its arrays on the host.

    Raises:
      JaxactError: as `host_model`; or the model has something that MJX does not simulate.
    """
    host = host_model(source)
    try:
        with jax.ensure_compile_time_eval(), jax.numpy_dtype_promotion("standard"):
            model = mjx().put_model(host, impl="jax")
            mjx().make_data(model)
            if not host.nmat:
                # Its rays look materials up, and there is nothing to look in.
                model = model.replace(mat_rgba=np.ones((1, 4), np.float32))
    except NotImplementedError as error:
        raise JaxactError(f"MJX cannot simulate this model: {error}") from error
    return jax.tree.map(np.asarray, model)


def gymnasium_asset(name: str) -> str:
    """Returns the path of a model that comes with Gymnasium, such as "hopper.xml".

    Raises:
      JaxactError: Gymnasium is not installed, or has no such model.
    """
    found = importlib.util.find_spec("gymnasium")
    if found is None or found.origin is None:
        raise JaxactError(
            f"the body is Gymnasium's {name}, and gymnasium is not installed: "
            "pip install 'jaxact[gymnasium]'"
        )
    folder = Path(found.origin).parent / "envs" / "mujoco" / "assets"
    if not (folder / name).is_file():
        raise unknown("model of Gymnasium", name, (path.name for path in folder.glob("*.xml")))
    return str(folder / name)
