"""Spaces as a recording's manifest describes them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxact.errors import JaxactError
from jaxact.spaces import Box, Dict, Discrete, Space, Tuple


def space_to_json(space: Space) -> dict[str, Any]:
    """Describes a space in JSON's types.

    Raises:
      JaxactError: the format knows no such space.
    """
    match space:
        case Discrete(n):
            return {"type": "Discrete", "n": n}
        case Box(low, high, shape, dtype):
            # As texts, for JSON has no infinities.
            bounds = {"low": str(float(low)), "high": str(float(high))}
            return {"type": "Box", **bounds, "shape": list(shape), "dtype": str(np.dtype(dtype))}
        case Tuple(parts):
            return {"type": "Tuple", "spaces": [space_to_json(part) for part in parts]}
        case Dict(named):
            return {"type": "Dict", "spaces": {n: space_to_json(x) for n, x in named.items()}}
    raise JaxactError(f"demonstrations cannot be recorded with a space like {space}")


def space_from_json(described: Mapping[str, Any]) -> Space:
    """Returns the space that `space_to_json` described.

    Raises:
      JaxactError: it describes none.
    """
    try:
        match described["type"]:
            case "Discrete":
                return Discrete(int(described["n"]))
            case "Box":
                low, high = float(described["low"]), float(described["high"])
                return Box(low, high, tuple(described["shape"]), described["dtype"])
            case "Tuple":
                return Tuple(tuple(space_from_json(part) for part in described["spaces"]))
            case "Dict":
                return dict_from_json(described)
    except (KeyError, TypeError, ValueError):
        pass
    raise JaxactError(f"the manifest describes no space with {json.dumps(described)}")


def dict_from_json(described: Mapping[str, Any]) -> Dict:
    """Returns the named spaces that `space_to_json` described.

    Raises:
      JaxactError: one of them is none.
    """
    return Dict({name: space_from_json(part) for name, part in described["spaces"].items()})
