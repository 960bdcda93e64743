"""Recorded episodes, and the files of other projects that hold them."""
