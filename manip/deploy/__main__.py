"""Answer measurements on stdin with commands on stdout, a JSON object a line.

    python -m manip.deploy lift.onnx

{"reset": true} begins an episode. Every other object holds measurements by name. A line
that cannot be used is answered with {"error": "why"}, and commands nothing.
"""

import json
import sys
from typing import Any

import numpy as np

from manip.deploy.runner import Runner


def main() -> None:
    """Answer measurements on stdin with commands on stdout, a JSON object a line."""
    if len(sys.argv) != 2:
        sys.exit("usage: python -m manip.deploy POLICY (a file of `manip export`)")
    try:
        runner = Runner(sys.argv[1])
    except (OSError, ValueError) as error:
        sys.exit(f"manip.deploy: error: {error}")
    for line in sys.stdin:
        answer = _answer(runner, line)
        if answer:
            print(json.dumps(answer), flush=True)


def _answer(runner: Runner, line: str) -> dict[str, Any]:
    """The command for a line of measurements; empty for a reset alone."""
    try:
        measured = json.loads(line)
        if not isinstance(measured, dict):
            raise ValueError("expected a JSON object of measurements")
        if measured.pop("reset", False):
            runner.reset()
        command = runner.step(measured)._asdict() if measured else {}
    except json.JSONDecodeError as error:
        return {"error": f"the line is no JSON: {error}"}
    except (TypeError, ValueError) as error:
        return {"error": str(error)}
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in command.items()
    }


if __name__ == "__main__":
    main()
