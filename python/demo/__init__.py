"""Demonstration of a fleet of two aircraft on this machine: S3 server, flights, a solve with another calibration, report."""
