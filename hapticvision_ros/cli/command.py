# Copyright 2026 The hapticvision_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The command line: one verb, one file, imported only when it is asked for."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from io import TextIOWrapper
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Final, NoReturn, Protocol, TextIO

from hapticvision_ros.core.errors import HapticVisionError, UsageError


class VerbModule(Protocol):
    """What the module of a verb offers."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the verb's arguments."""
        ...

    def run(self, args: argparse.Namespace) -> int:
        """Do it, and return the exit code."""
        ...


@dataclass(frozen=True, slots=True)
class Verb:
    """A verb: `module` below ``hapticvision_ros.cli``, and what it does in one line."""

    module: str
    summary: str


VERBS: Final = {
    'import': Verb('import_csv', 'turn measured CSV files into bags'),
    'fit': Verb('fit', 'estimate rheological parameters from bags'),
    'export': Verb('export', 'write a fitted model for finite-element codes and simulators'),
    'shape': Verb('shape', 'simulate the object and hold it against the clouds of a bag'),
    'demo': Verb('demo', 'run an experiment on the simulated cell, fit it and real data'),
    'cell': Verb('cell', "start the cell's nodes"),
    'faults': Verb('faults', 'show what happens to the cell when something goes wrong'),
    'replay': Verb('replay', 'play a bag through the nodes'),
}


class Parser(argparse.ArgumentParser):
    """An argument parser that complains in one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise what `run` prints."""
        raise UsageError(f'{message.rstrip(".")}; see {self.prog} --help.')


class _Version(argparse.Action):
    """Look the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print it and exit."""
        print(f'hapticvision_ros {version("hapticvision_ros")}')
        parser.exit()


def run(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit code, unless it is interrupted."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            # A terminal that knows no ± still shows the rest.
            stream.reconfigure(errors='replace')
    try:
        code = _run(arguments)
        sys.stdout.flush()
        return code
    except HapticVisionError as error:
        # One sentence, whether it was written for this line or for a list of warnings.
        print(f'hapticvision: {str(error).rstrip(".")}.', file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        # The reader of our output has left, as `head` does; nothing is wrong here.
        _silence(sys.stdout)
        return 0
    except OSError as error:
        if error.filename is not None:
            print(f'hapticvision: {error.filename}: {error.strerror}.', file=sys.stderr)
            return UsageError.exit_code
        # A full disk behind our output, say.
        _silence(sys.stdout)
        print(f'hapticvision: the output cannot be written ({error.strerror}).', file=sys.stderr)
        return UsageError.exit_code


def check_out(out: Path) -> None:
    """Refuse an ``--out`` that can be no folder, or not be written to, before work begins."""
    there = next((path for path in (out, *out.parents) if path.exists()), out)
    if not there.is_dir():
        raise UsageError(f'--out {out}: {there} is a file: name a directory.')
    try:
        # What may be written there is known once something was: rights do not tell all of it.
        with TemporaryDirectory(prefix='.hapticvision-', dir=there):
            pass
    except OSError as error:
        raise UsageError(
            f'--out {out}: {there} cannot be written to ({error.strerror}): choose another.'
        ) from error


def _run(arguments: Sequence[str]) -> int:
    """Parse the arguments and run the verb."""
    parser = Parser(
        prog='hapticvision',
        description='Robotic texture analyser: rheological parameters from touch and sight.',
    )
    parser.add_argument('--version', action=_Version, nargs=0, help='show the version and exit')
    verbs = parser.add_subparsers(dest='verb', metavar='VERB', required=True)
    asked = next((argument for argument in arguments if argument in VERBS), None)
    module: VerbModule | None = None
    for name, verb in VERBS.items():
        subparser = verbs.add_parser(name, help=verb.summary, description=verb.summary + '.')
        if name == asked:
            module = import_module(f'hapticvision_ros.cli.{verb.module}')
            module.add_arguments(subparser)
    for argument in arguments:
        # As a path it would be the folder that one is in.
        if not argument or (argument.startswith('--') and argument.endswith('=')):
            raise UsageError(
                f"an argument is empty ('{argument}'): see whether a variable of the shell is "
                'not set.'
            )
    args = parser.parse_args(arguments)
    if module is None:
        raise UsageError('say what to do; see hapticvision --help.')
    return module.run(args)


def _silence(stream: TextIO) -> None:
    """Let nothing more be written to a closed pipe, not even at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
