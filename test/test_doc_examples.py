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

"""The examples of the documentation print what stands beneath them."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import re
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
NUMBER = re.compile(r'(?<![\w.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?')
UNITS_IN_THE_LAST_PLACE = 2.0
SHARE = 1e-4
"""A fit ends where its cost no longer falls, which is not at the same last digits everywhere."""


def _load() -> ModuleType:
    spec = spec_from_file_location('doc_examples', ROOT / 'tools' / 'doc_examples.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


TOOL = _load()


def _last_place(number: str) -> float:
    """Return the worth of the last digit of a printed number."""
    digits, _, exponent = number.partition('e')
    return 10.0 ** (int(exponent or 0) - len(digits.partition('.')[2]))


def differences(stated: str, printed: str) -> list[str]:
    """Return what differs between two texts, beyond the last digits of numbers."""
    found = []
    if NUMBER.sub('#', stated).split() != NUMBER.sub('#', printed).split():
        found.append(f'the text differs:\n{printed}')
        return found
    for left, right in zip(NUMBER.findall(stated), NUMBER.findall(printed), strict=True):
        # Both have all digits that are printed, less zeros at their end.
        place = min(_last_place(left), _last_place(right))
        tolerance = max(UNITS_IN_THE_LAST_PLACE * place, SHARE * abs(float(left)))
        if abs(float(left) - float(right)) > 1.001 * tolerance:
            found.append(f'{left} is stated, {right} is printed')
    return found


@pytest.mark.parametrize('page', TOOL.PAGES)
def test_each_example_prints_what_the_page_says(page: str) -> None:
    names: dict[str, object] = {}
    examples = list(TOOL.examples((ROOT / page).read_text()))
    assert examples
    for code, stated in examples:
        printed = TOOL.run(code, names, page)
        assert differences(stated, printed) == [], 'run: python tools/doc_examples.py'


@pytest.mark.parametrize('page', TOOL.PAGES)
def test_no_python_of_a_page_is_left_out(page: str) -> None:
    text = (ROOT / page).read_text()
    assert text.count('```python\n') == len(list(TOOL.examples(text)))


def test_numbers_are_compared_to_their_last_digits() -> None:
    assert differences('K1 = 2000.1 +- 2.5 N/m', 'K1 = 2000.2 +- 2.5 N/m') == []
    assert differences('K1 = 2000.1 +- 2.5 N/m', 'K1 = 2000.9 +- 2.5 N/m') != []
    assert differences('5.47e-05 m', '5.48e-05 m') == []
    assert differences('5.47e-05 m', '5.57e-05 m') != []
    assert differences('elastic', 'plastic') != []
