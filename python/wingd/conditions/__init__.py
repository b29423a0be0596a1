"""Aircraft data in tables of any kind, as the canonical table that ``wingd aircraft-data`` joins with the frames.

The canonical table is a CSV with a column ``utc`` (ISO 8601) and columns named with their units.
"""

from wingd.conditions.mapping import MappedColumn, Mapping, read_mapping
from wingd.conditions.table import Conditions, read_conditions
from wingd.conditions.units import QUANTITIES

__all__ = ["QUANTITIES", "Conditions", "MappedColumn", "Mapping", "read_conditions", "read_mapping"]
