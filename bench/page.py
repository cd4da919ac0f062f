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

"""A part of a page of doc/ that a bench writes, between two comments."""

from pathlib import Path


def renew(page: Path, begin: str, end: str, text: str) -> None:
    """
    Put what a bench found in the place of what it found before.

    Parameters
    ----------
    page : Path
        Read when it is written, so that it may be edited while the bench runs.
    begin, end : str
        The comments that stand before and after it, once each.
    text : str
        What goes between them.

    Raises
    ------
    SystemExit
        If there is no such page, or they do not stand there; the text was printed.

    """
    try:
        old = page.read_text()
    except OSError as error:
        raise SystemExit(f'{page} cannot be renewed ({error.strerror})') from error
    if old.count(begin) != 1 or old.count(end) != 1 or old.index(begin) > old.index(end):
        raise SystemExit(f'{page} is left alone: {begin} and {end} are not there once each')
    head, rest = old.split(begin)
    page.write_text(f'{head}{begin}\n\n{text}\n{end}{rest.split(end)[1]}')
