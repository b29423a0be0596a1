"""A fleet of two on this machine: an S3 server, two recorders' flights, a solve with another calibration, a report."""
