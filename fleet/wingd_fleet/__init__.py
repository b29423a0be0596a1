"""Many flights of many aircraft: solved again, kept as tables, asked. docs/fleet.md says how."""

__version__ = "0.2.0"
