"""Many training runs: sweeps over options and seeds, on one machine or on several."""
