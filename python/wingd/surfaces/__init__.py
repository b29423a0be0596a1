"""Surfaces of CAD, CFD and FEM models, moved by the measured shape of the wing.

>>> surface = read_surface("wing.stl", unit="mm")
>>> moved = deform(surface, shape, axes="cad")
>>> write_files(moved, "deformed")
"""

from wingd.surfaces.deformation import Deformation
from wingd.surfaces.formats import read_surface, write_files
from wingd.surfaces.model import UNITS, Surface
from wingd.surfaces.placement import Moved, check_placement, deform

__all__ = ["UNITS", "Deformation", "Moved", "Surface", "check_placement", "deform", "read_surface", "write_files"]
