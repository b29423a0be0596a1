"""Surfaces of CAD, CFD and FEM models, moved by the measured shape of the wing.

>>> moved = wingd.open("store")["f0001"].shape().wingd.deform("wing.stl", unit="mm", axes="cad")
>>> write_files(moved, "deformed")
"""

from wingd.surfaces.deformation import Deformation
from wingd.surfaces.formats import as_surface, read_surface, write_files
from wingd.surfaces.model import UNITS, Surface
from wingd.surfaces.placement import Moved, check_placement, deform

__all__ = [
    "UNITS",
    "Deformation",
    "Moved",
    "Surface",
    "as_surface",
    "check_placement",
    "deform",
    "read_surface",
    "write_files",
]
