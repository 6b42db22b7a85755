"""The lecture on the cam-driven beam: its records, protocols and published results, by today's means."""
