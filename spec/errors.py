"""The one exception for bad input from a user: a file, a parameter, a gaze, a camera."""

import os
import sys
from collections.abc import Callable


class InputError(ValueError):
    """Bad input. The message names the offending value and says what is accepted."""


def run_command_line(main: Callable[[], int | None]) -> None:
    """Runs `main` and exits with its status. InputError becomes one line on standard error and status 2; Ctrl-C gives 130."""
    try:
        sys.exit(main() or 0)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # whoever reads the output, such as `head`, has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
