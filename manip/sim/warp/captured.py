"""Captured: launch the same kernels again and again, as a graph on CUDA."""

from collections.abc import Callable

import warp as wp


class Captured:
    """Call a function that launches kernels; on CUDA, capture it as a graph.

    The first call launches the kernels one by one, which compiles them. On CUDA, the
    second call captures them, and later ones repeat the graph. The function must always
    launch the same kernels on the same arrays, on the present device of Warp.

    Args:
        launch: the function.
    """

    def __init__(self, launch: Callable[[], None]) -> None:
        self._launch = launch
        self._compiled, self._graph = False, None

    def __call__(self) -> None:
        """Launch the kernels."""
        if not (self._compiled and wp.get_device().is_cuda):
            self._launch()
            self._compiled = True
            return
        if self._graph is None:
            with wp.ScopedCapture() as capture:
                self._launch()
            self._graph = capture.graph
        wp.capture_launch(self._graph)
