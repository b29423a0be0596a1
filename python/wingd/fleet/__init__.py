"""Many flights of many aircraft: solve them again, store the results as tables, query them. See docs/fleet.md."""
