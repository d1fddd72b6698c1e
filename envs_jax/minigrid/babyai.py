"""BabyAI's levels: a table of ids, without the prefix `BabyAI-`, and what each one samples."""

from __future__ import annotations

from envs_jax.minigrid import tiles
from envs_jax.minigrid.instructions import GO_TO, PICK_UP
from envs_jax.minigrid.samplers.babyai.doors import (
    OpenDoorSampler,
    OpenDoorsInOrderSampler,
    OpenRedDoorSampler,
    OpenTwoDoorsSampler,
    RoundDoorsSampler,
)
from envs_jax.minigrid.samplers.babyai.level import LevelSampler
from envs_jax.minigrid.samplers.babyai.level_gen import LevelGenSampler
from envs_jax.minigrid.samplers.babyai.mazes import MazeSampler
from envs_jax.minigrid.samplers.babyai.one_room import GoToSampler, Target
from envs_jax.minigrid.samplers.babyai.pickup import (
    FindObjSampler,
    KeyCorridorSampler,
    OneRoomSampler,
    PickupDistSampler,
)
from envs_jax.minigrid.samplers.babyai.put_next import (
    MoveTwoAcrossSampler,
    PutNextLocalSampler,
    PutNextSampler,
)
from envs_jax.minigrid.samplers.babyai.unlock import (
    UnlockLocalSampler,
    UnlockPickupSampler,
    UnlockSampler,
    UnlockToUnlockSampler,
)
from envs_jax.minigrid.samplers.room_grid import RoomGrid

# One-room GoTo levels: room size, objects in all, target.
_GO_TO: dict[str, tuple[int, int, Target]] = {
    "GoToRedBallGrey-v0": (8, 8, "red ball among grey"),
    "GoToRedBall-v0": (8, 8, "red ball"),
    "GoToRedBallNoDists-v0": (8, 1, "red ball"),
    "GoToRedBlueBall-v0": (8, 8, "red or blue ball"),
    "GoToObj-v0": (8, 1, "any"),
    "GoToObjS4-v0": (4, 1, "any"),
    "GoToObjS6-v1": (6, 1, "any"),
    "GoToLocal-v0": (8, 8, "any"),
    "GoToLocalS5N2-v0": (5, 2, "any"),
    "GoToLocalS6N2-v0": (6, 2, "any"),
    "GoToLocalS6N3-v0": (6, 3, "any"),
    "GoToLocalS6N4-v0": (6, 4, "any"),
    "GoToLocalS7N4-v0": (7, 4, "any"),
    "GoToLocalS7N5-v0": (7, 5, "any"),
    "GoToLocalS8N2-v0": (8, 2, "any"),
    "GoToLocalS8N3-v0": (8, 3, "any"),
    "GoToLocalS8N4-v0": (8, 4, "any"),
    "GoToLocalS8N5-v0": (8, 5, "any"),
    "GoToLocalS8N6-v0": (8, 6, "any"),
    "GoToLocalS8N7-v0": (8, 7, "any"),
}


def one_room_levels() -> dict[str, GoToSampler]:
    """Returns the levels of one room whose instruction is to go to an object."""
    return {
        name: GoToSampler(size, objects, size**2, target)
        for name, (size, objects, target) in _GO_TO.items()
    }


def levels() -> dict[str, LevelSampler]:
    """Returns all other levels."""
    return {
        **_go_to_levels(),
        **_open_levels(),
        **_pickup_levels(),
        **_put_next_levels(),
        **_unlock_levels(),
        **_other_levels(),
        **_generated_levels(),
    }


def _maze(room_size: int = 8) -> RoomGrid:
    return RoomGrid(room_size, 3, 3)


def _row(room_size: int, columns: int) -> RoomGrid:
    return RoomGrid(room_size, columns, 1)


def _go_to_levels() -> dict[str, LevelSampler]:
    mazes = {
        "GoTo-v0": MazeSampler(_maze()),
        "GoToOpen-v0": MazeSampler(_maze(), doors_open=True),
        "GoToObjMaze-v0": MazeSampler(_maze(), num_objects=1),
        "GoToObjMazeOpen-v0": MazeSampler(_maze(), num_objects=1, doors_open=True),
        "GoToObjMazeS4R2-v0": MazeSampler(RoomGrid(4, 2, 2), num_objects=1),
    }
    for size in (4, 5, 6, 7):
        mazes[f"GoToObjMazeS{size}-v0"] = MazeSampler(_maze(size), num_objects=1)
    return {
        **mazes,
        "GoToImpUnlock-v0": UnlockSampler(_maze(), objects_a_room=2, go_to=True),
        "GoToDoor-v0": RoundDoorsSampler(_maze(7)),
        "GoToObjDoor-v0": RoundDoorsSampler(_maze(), kind="objects", num_objects=8),
    }


def _open_levels() -> dict[str, LevelSampler]:
    two = _maze(6), 20 * 6**2
    red_blue = (tiles.RED, tiles.BLUE)
    return {
        "Open-v0": MazeSampler(_maze(), verb="open"),
        "OpenRedDoor-v0": OpenRedDoorSampler(_row(5, 2)),
        "OpenDoor-v0": OpenDoorSampler(_maze()),
        "OpenDoorDebug-v0": OpenDoorSampler(_maze(), strict=True),
        "OpenDoorColor-v0": OpenDoorSampler(_maze(), select_by="color"),
        "OpenDoorLoc-v0": OpenDoorSampler(_maze(), select_by="location"),
        "OpenTwoDoors-v0": OpenTwoDoorsSampler(*two),
        "OpenRedBlueDoors-v0": OpenTwoDoorsSampler(*two, red_blue),
        "OpenRedBlueDoorsDebug-v0": OpenTwoDoorsSampler(*two, red_blue, strict=True),
        "OpenDoorsOrderN2-v0": OpenDoorsInOrderSampler(*two, 2),
        "OpenDoorsOrderN4-v0": OpenDoorsInOrderSampler(*two, 4),
        "OpenDoorsOrderN2Debug-v0": OpenDoorsInOrderSampler(*two, 2, strict=True),
        "OpenDoorsOrderN4Debug-v0": OpenDoorsInOrderSampler(*two, 4, strict=True),
    }


def _pickup_levels() -> dict[str, LevelSampler]:
    return {
        "Pickup-v0": MazeSampler(_maze(), verb="pick up"),
        "UnblockPickup-v0": MazeSampler(_maze(), verb="pick up", num_objects=20, blocked=True),
        "PickupLoc-v0": LevelGenSampler(
            _row(8, 1),
            num_objects=8,
            verbs=(PICK_UP,),
            locked_room=0,
            unblocking=False,
            sequences=False,
        ),
        "PickupDist-v0": PickupDistSampler(_row(7, 1)),
        "PickupDistDebug-v0": PickupDistSampler(_row(7, 1), strict=True),
        "PickupAbove-v0": FindObjSampler(_maze(6), 8 * 6**2, above=True),
    }


def _put_next_levels() -> dict[str, LevelSampler]:
    found: dict[str, LevelSampler] = {
        "PutNextLocal-v0": PutNextLocalSampler(_row(8, 1), num_objects=8),
        "PutNextLocalS5N3-v0": PutNextLocalSampler(_row(5, 1), num_objects=3),
        "PutNextLocalS6N4-v0": PutNextLocalSampler(_row(6, 1), num_objects=4),
        "MoveTwoAcrossS5N2-v0": MoveTwoAcrossSampler(_row(5, 2), 16 * 5**2, 2),
        "MoveTwoAcrossS8N9-v0": MoveTwoAcrossSampler(_row(8, 2), 16 * 8**2, 9),
    }
    for size, objects in ((4, 1), (5, 1), (5, 2), (6, 3), (7, 4)):
        grid, time = _row(size, 2), 8 * size**2
        found[f"PutNextS{size}N{objects}-v0"] = PutNextSampler(grid, time, objects)
        if objects > 1:
            name = f"PutNextS{size}N{objects}Carrying-v0"
            found[name] = PutNextSampler(grid, time, objects, start_carrying=True)
    return found


def _unlock_levels() -> dict[str, LevelSampler]:
    return {
        "Unlock-v0": UnlockSampler(_maze()),
        "UnlockLocal-v0": UnlockLocalSampler(_maze()),
        "UnlockLocalDist-v0": UnlockLocalSampler(_maze(), num_distractors=3),
        "KeyInBox-v0": UnlockLocalSampler(_maze(), in_box=True),
        # The package means to give these more time, but does not.
        "UnlockPickup-v0": UnlockPickupSampler(_row(6, 2)),
        "UnlockPickupDist-v0": UnlockPickupSampler(_row(6, 2), num_distractors=4),
        "BlockedUnlockPickup-v0": UnlockPickupSampler(_row(6, 2), 16 * 6**2, blocked=True),
        "UnlockToUnlock-v0": UnlockToUnlockSampler(_row(6, 3), 30 * 6**2),
    }


def _other_levels() -> dict[str, LevelSampler]:
    found: dict[str, LevelSampler] = {
        "ActionObjDoor-v0": RoundDoorsSampler(_maze(7), kind="actions", num_objects=5),
        "KeyCorridor-v0": KeyCorridorSampler(_maze(6), 30 * 6**2),
    }
    for size in (5, 6, 7):
        found[f"FindObjS{size}-v0"] = FindObjSampler(_maze(size), 20 * size**2)
    for size, rows in ((3, 1), (3, 2), (3, 3), (4, 3), (5, 3), (6, 3)):
        grid = RoomGrid(size, 3, rows)
        found[f"KeyCorridorS{size}R{rows}-v0"] = KeyCorridorSampler(grid, 30 * size**2)
    for size in (8, 12, 16, 20):
        found[f"OneRoomS{size}-v0"] = OneRoomSampler(_row(size, 1))
    return found


def _generated_levels() -> dict[str, LevelSampler]:
    def go_to_seq(grid: RoomGrid, objects: int) -> LevelSampler:
        return LevelGenSampler(
            grid,
            num_objects=objects,
            verbs=(GO_TO,),
            locked_room=0,
            locations=False,
            unblocking=False,
        )

    def synth(grid: RoomGrid) -> LevelSampler:
        return LevelGenSampler(grid, locations=False, implicit_unlock=False, sequences=False)

    return {
        "GoToSeq-v0": go_to_seq(_maze(), 18),
        "GoToSeqS5R2-v0": go_to_seq(RoomGrid(5, 2, 2), 4),
        "Synth-v0": synth(_maze()),
        # Two rows, as its name says, but three columns.
        "SynthS5R2-v0": synth(RoomGrid(5, 3, 2)),
        "SynthLoc-v0": LevelGenSampler(_maze(), implicit_unlock=False, sequences=False),
        "SynthSeq-v0": LevelGenSampler(_maze(), implicit_unlock=False),
        "MiniBossLevel-v0": LevelGenSampler(RoomGrid(5, 2, 2), num_objects=7, locked_room=0.25),
        "BossLevel-v0": LevelGenSampler(_maze()),
        "BossLevelNoUnlock-v0": LevelGenSampler(_maze(), locked_room=0, implicit_unlock=False),
    }
