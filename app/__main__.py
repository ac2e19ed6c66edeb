"""The program `vinspect`: parses the command line, calls one of `app.commands`, turns trouble into a sentence.

Exit codes: 0 done, 2 the user's input is at fault (one sentence on stderr), 130 interrupted with Ctrl-C.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence

# numpy, scipy and OpenCV read these when they are first imported.  One thread: several are slower for matrices of
# this size, and the order of additions, hence the last bits of a run, would depend on the machine.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `vinspect` with these arguments (those of the process by default) and return its exit code."""
    from vins_core.errors import VinspectError

    try:
        _parse_and_call(list(sys.argv[1:] if arguments is None else arguments) or ["open"])
    except VinspectError as problem:
        print(f"vinspect: {problem}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("vinspect: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # e.g. `vinspect info ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except SystemExit as ending:  # of the argument parser: 0 after --help, 2 for what it cannot parse
        return ending.code if isinstance(ending.code, int) else 2
    return 0


def _parse_and_call(arguments: list[str]) -> None:
    import tyro

    from .commands import COMMANDS

    program = tyro.extras.SubcommandApp()
    for name, command in COMMANDS.items():
        if isinstance(command, Mapping):
            group = tyro.extras.SubcommandApp()
            for inner, inner_command in command.items():
                group.command(name=inner)(inner_command)
            program.command(group, name=name, help="Save the map of a run, or load one for another session.")
        else:
            program.command(name=name)(command)
    program.cli(
        prog="vinspect",
        description="A visual debugger for visual-inertial SLAM. Without arguments it opens the bundled sample.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )


if __name__ == "__main__":
    sys.exit(main())
