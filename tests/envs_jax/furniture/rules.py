"""The rules of FurnMove and FurnLift once more, in plain Python on sets of cells."""

from __future__ import annotations

import math

STEPS = {0: (-1, 0), 1: (0, 1), 2: (1, 0), 3: (0, -1)}
TELEVISION = {(-1, -1), (-1, 0), (-1, 1)} | {(r, c) for r in (0, 1) for c in range(-2, 3)}
DRESSER = {(r, c) for r in (-1, 0, 1) for c in range(-2, 3)}


def add(a, b):
    return (a[0] + b[0], a[1] + b[1])


def body(shape, middle, yaw):
    for _ in range(yaw):
        shape = {(c, -r) for r, c in shape}
    return {add(middle, cell) for cell in shape}


def coordinated(names, yaws, one_passes):
    """None if the actions are not, else "individual" or "together"."""
    own = {"move_ahead", "rotate_left", "rotate_right", "pass"}
    if all(name in own for name in names):
        return "individual" if "pass" in names or not one_passes else None
    if any(name in own for name in names):
        return None
    if names[0] == names[1] == "rotate_object_right":
        return "together"
    ways, kinds = [], []
    for name, yaw in zip(names, yaws, strict=True):
        for i, way in enumerate(("ahead", "right", "back", "left")):
            if f"_{way}" in name and name != "rotate_object_right":
                ways.append((i + yaw) % 4)
                kinds.append(name.replace(way, ""))
    return "together" if len(ways) == 2 and len(set(ways)) == len(set(kinds)) == 1 else None


def can_stand(world, cell, middle, yaw):
    under = body(TELEVISION, middle, yaw)
    near = min(math.dist(cell, other) for other in under) * 0.25 <= 0.76
    return cell not in under and near


def move(world, air, names, one_passes):
    """Changes the world by one step of FurnMove; returns its kind and whose action was done.

    The television's body must be part of the air.
    """
    kind = coordinated(names, world["yaw"], one_passes)
    if kind == "together":
        middle, turned, agents = world["object"], world["object_yaw"], list(world["agents"])
        if names[0] == "rotate_object_right":
            turned = (turned + 1) % 4
        else:
            ways = ("ahead", "right", "back", "left")
            relative = next(i for i, way in enumerate(ways) if f"_{way}" in names[0])
            step = STEPS[(world["yaw"][0] + relative) % 4]
            middle = add(middle, step)
            if "agents" in names[0]:
                agents = [add(a, step) for a in agents]
                if not set(agents) <= world["floor"]:
                    return kind, [False, False]
        if not body(TELEVISION, middle, turned) <= air:
            return kind, [False, False]
        if not all(can_stand(world, a, middle, turned) for a in agents):
            return kind, [False, False]
        world.update(object=middle, object_yaw=turned, agents=agents)
        return kind, [True, True]
    done = []
    for i, name in enumerate(names):
        if one_passes and "pass" not in names:
            done.append(False)
        elif name in ("rotate_left", "rotate_right"):
            world["yaw"][i] = (world["yaw"][i] + (1 if name == "rotate_right" else -1)) % 4
            done.append(True)
        elif name == "move_ahead":
            to = add(world["agents"][i], STEPS[world["yaw"][i]])
            free = to in world["floor"] and to != world["agents"][1 - i]
            done.append(free and can_stand(world, to, world["object"], world["object_yaw"]))
            if done[-1]:
                world["agents"][i] = to
        else:
            done.append(name == "pass")
    return kind, done


def sees(world, agent):
    (r, c), yaw = world["agents"][agent], world["yaw"][agent]
    dr, dc = world["object"][0] - r, world["object"][1] - c
    if math.hypot(dr, dc) * 0.25 > 1.25:
        return False
    bearing = math.degrees(math.atan2(dc, -dr)) - 90 * yaw
    return abs((bearing + 180) % 360 - 180) <= 45 + 1e-9


def lift(world, names, block):
    """Changes the world by one step of FurnLift; returns liftable, lifted and whose was done."""
    (a, b), (c, d) = world["agents"]
    liftable = sees(world, 0) and sees(world, 1) and abs(a - c) + abs(b - d) >= 8
    if liftable and list(names) == ["pickup", "pickup"]:
        return True, True, [True, True]
    done = []
    for i, name in enumerate(names):
        if name == "move_ahead":
            to = add(world["agents"][i], STEPS[world["yaw"][i]])
            done.append(to in world["floor"] and not (block and to == world["agents"][1 - i]))
            if done[-1]:
                world["agents"][i] = to
            continue
        if name.startswith("rotate"):
            world["yaw"][i] = (world["yaw"][i] + (1 if name == "rotate_right" else -1)) % 4
        done.append(name != "pickup")
    return liftable, False, done
