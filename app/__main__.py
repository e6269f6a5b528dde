"""The command line: `telepresence COMMAND ...`; the contract of its commands is `--help`."""

from __future__ import annotations

import importlib
import signal
import sys
import threading
import traceback

import click

from spatial.errors import InputError, MissingError, TelepresenceError

COMMANDS = {
    "demo": "the main job: simulated site, tracker, viewer, browser tab",
    "detect": "find markers in images",
    "doctor": "say what works on this machine and what to install",
    "info": "summarise a recording",
    "objects": "the object database without a browser",
    "play": "play a recording in a viewer of its own",
    "record": "record a session",
    "repair": "make a damaged recording whole",
    "robot": "check a robot description",
    "site": "the simulated site alone",
    "track": "run a tracker on a recording or a live site",
    "view": "the operator station alone",
}
BAD_INPUT, FAILURE, INTERRUPTED = 2, 1, 130


class LazyGroup(click.Group):
    """Loads a command's module when it is called: `--help` stays quick."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        del ctx
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return one command, `None` when there is none of that name."""
        del ctx
        if cmd_name not in COMMANDS:
            return None
        command = importlib.import_module(f"app.commands.{cmd_name}").command
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands without importing any."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(sorted(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
def cli() -> None:
    """See a remote robot site in 3D, as it is now, in a browser tab.

    Example: telepresence demo --scenario pick
    """


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 failed, 2 bad input."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as tidily as Ctrl-C
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        result = cli.main(args=words, prog_name="telepresence", standalone_mode=False)
    except (click.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except BrokenPipeError:
        return FAILURE
    except Exception as error:  # noqa: BLE001 - the last boundary: one line instead of a traceback
        return _fail(error, debug=debug)
    return result if isinstance(result, int) else 0


def _fail(error: Exception, *, debug: bool) -> int:
    """Say in one line what was wrong and return the exit code that goes with it."""
    if debug:
        traceback.print_exc()
    bad_input = isinstance(error, click.ClickException | InputError | MissingError)
    if isinstance(error, click.ClickException):
        text = error.format_message()
    elif isinstance(error, TelepresenceError):
        text = str(error)
    else:
        text = f"unexpected {type(error).__name__}: {error}; --debug shows where"
    click.echo(f"telepresence: {' '.join(text.split())}", err=True)
    return BAD_INPUT if bad_input else FAILURE


if __name__ == "__main__":
    sys.exit(main())
