"""Files: atomic writes, checksums, and dataclasses from plain values."""
