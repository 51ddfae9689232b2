"""Orchard scenes: tree rows grown from a seed or measured, with fruit."""

from hplan.scene.orchard.capsule_file import import_capsules, import_tree
from hplan.scene.orchard.fruits import fruit_at_tips
from hplan.scene.orchard.generator import generate, measured_orchard
from hplan.scene.orchard.options import SHIPPED, TUCKED_DEG, FruitZone, MeasuredOptions, OrchardOptions

__all__ = [
    "SHIPPED",
    "TUCKED_DEG",
    "FruitZone",
    "MeasuredOptions",
    "OrchardOptions",
    "fruit_at_tips",
    "generate",
    "import_capsules",
    "import_tree",
    "measured_orchard",
]
