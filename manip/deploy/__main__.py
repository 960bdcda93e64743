"""Answer measurements on stdin with commands on stdout, a JSON object a line.

    python -m manip.deploy lift.onnx

{"reset": true} begins an episode. Every other object holds measurements by name.
"""

import json
import sys

import numpy as np

from manip.deploy.runner import Runner


def main() -> None:
    """Answer measurements on stdin with commands on stdout, a JSON object a line."""
    runner = Runner(sys.argv[1])
    for line in sys.stdin:
        measured = json.loads(line)
        if measured.pop("reset", False):
            runner.reset()
        if measured:
            fields = runner.step(measured)._asdict().items()
            answer = {
                k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in fields
            }
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
