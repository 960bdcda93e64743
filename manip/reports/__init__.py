"""Reports: one HTML page about training runs, their evaluation and their episodes."""
