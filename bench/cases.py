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


"""Cases of a long bench, a line of JSON each, so that it can be stopped and taken up again."""

from collections.abc import Callable, Iterable
import json
from pathlib import Path
from typing import Any

type Case = dict[str, Any]


def kept(lines: Path) -> list[Case]:
    """Return the cases that a file holds; none where there is no file."""
    return [json.loads(each) for each in lines.read_text().splitlines()] if lines.exists() else []


def carry_out(
    lines: Path,
    tasks: Iterable[Case],
    key: Callable[[Case], str],
    case: Callable[[Case], Case],
    line: Callable[[Case], str],
) -> None:
    """
    Run the cases that are not in a file yet, and add them to it.

    Parameters
    ----------
    lines : Path
        The file.
    tasks : iterable of dict
        The cases that are asked for.
    key : callable
        What tells a case from others.
    case : callable
        Runs one and returns it with what came of it.
    line : callable
        Returns it in a line.

    """
    known = {key(each) for each in kept(lines)}
    todo = [task for task in tasks if key(task) not in known]
    with lines.open('a') as file:
        for count, task in enumerate(todo, start=1):
            result = case(task)
            file.write(json.dumps(result) + '\n')
            file.flush()
            print(f'{count}/{len(todo)} {line(result)}', flush=True)
