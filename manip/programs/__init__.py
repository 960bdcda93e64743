"""Programs: what `manip NAME` and scripts/NAME.py run."""
