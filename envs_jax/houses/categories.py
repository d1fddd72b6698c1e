"""What boxes and rooms are called: AI2-THOR's object types, and its kinds of rooms."""

from __future__ import annotations

from jaxact.errors import unknown

# Structure first, then furniture, then ROBOTHOR_TARGETS, then other objects.
STRUCTURE = ("Nothing", "Floor", "Ceiling", "Wall", "Door", "Window")
ROBOTHOR_TARGETS = (
    "AlarmClock",
    "Apple",
    "BaseballBat",
    "BasketBall",
    "Bowl",
    "GarbageCan",
    "HousePlant",
    "Laptop",
    "Mug",
    "SprayBottle",
    "Television",
    "Vase",
)
FURNITURE = (
    "ArmChair",
    "Bathtub",
    "Bed",
    "Cabinet",
    "Chair",
    "CoffeeTable",
    "CounterTop",
    "Desk",
    "DiningTable",
    "Drawer",
    "Dresser",
    "Fridge",
    "Ottoman",
    "Safe",
    "Shelf",
    "ShelvingUnit",
    "SideTable",
    "Sink",
    "Sofa",
    "Stool",
    "StoveBurner",
    "Toilet",
    "TVStand",
)
OTHERS: tuple[str, ...] = (
    "Book",
    "Box",
    "Candle",
    "CellPhone",
    "Cup",
    "Microwave",
    "Pan",
    "Pillow",
    "Plate",
    "Pot",
)
OTHERS += ("RemoteControl", "Statue", "TeddyBear", "Toaster", "WashingMachine", "Object")
OTHERS += ("AluminumFoil", "BathtubBasin", "Blinds", "Boots", "Bottle", "Bread", "ButterKnife")
OTHERS += ("CD", "Cart", "Cloth", "ClothesDryer", "CoffeeMachine", "CreditCard", "Curtains")
OTHERS += ("DeskLamp", "Desktop", "DishSponge", "DogBed", "Dumbbell", "Egg", "Faucet", "FloorLamp")
OTHERS += ("Footstool", "Fork", "GarbageBag", "HandTowel", "HandTowelHolder", "Kettle", "KeyChain")
OTHERS += ("Knife", "Ladle", "LaundryHamper", "Lettuce", "LightSwitch", "Mirror", "Newspaper")
OTHERS += ("Painting", "PaperTowelRoll", "Pen", "Pencil", "PepperShaker", "Plunger", "Poster")
OTHERS += ("Potato", "RoomDecor", "SaltShaker", "ScrubBrush", "ShowerCurtain", "ShowerDoor")
OTHERS += ("ShowerGlass", "ShowerHead", "SinkBasin", "SoapBar", "SoapBottle", "Spatula", "Spoon")
OTHERS += ("StoveKnob", "TableTopDecor", "TennisRacket", "TissueBox", "ToiletPaper")
OTHERS += ("ToiletPaperHanger", "Tomato", "Towel", "TowelHolder", "VacuumCleaner", "Watch")
OTHERS += ("WateringCan", "WineBottle")
NAMES = (*STRUCTURE, *FURNITURE, *ROBOTHOR_TARGETS, *OTHERS)
ROOMS = ("Nothing", "Kitchen", "LivingRoom", "Bedroom", "Bathroom")
_INDEX = {name: i for i, name in enumerate(NAMES)}


def index(name: str) -> int:
    """Returns the number of a category.

    Raises:
      JaxactError: there is no such category; the message names the nearest.
    """
    if name not in _INDEX:
        raise unknown("category", name, NAMES)
    return _INDEX[name]
