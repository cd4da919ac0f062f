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


"""The report: one HTML file that needs nothing else and opens offline."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.report.quantities import SI_UNITS, UnitSystem
from hapticvision_ros.report.sections import (
    caveats,
    diagnosis,
    effects,
    errors,
    method,
    parameters,
    provenance,
    residual,
    summary,
    trials,
)
from hapticvision_ros.report.writing import as_bytes, write_whole

type Fill = Callable[[CampaignAnalysis, UnitSystem], Mapping[str, object]]

SECTIONS: Final[tuple[tuple[str, Fill], ...]] = (
    ('summary', summary.fill),
    ('diagnosis', diagnosis.fill),
    ('parameters', parameters.fill),
    ('errors', errors.fill),
    ('residual', residual.fill),
    ('caveats', caveats.fill),
    ('trials', trials.fill),
    ('provenance', provenance.fill),
    ('effects', effects.fill),
    ('method', method.fill),
)
"""Name of the template and what fills it, in the order of the page."""

TITLE: Final = 'Rheological parameters'


def render(campaign: CampaignAnalysis, units: UnitSystem = SI_UNITS) -> str:
    """
    Return the report as an HTML page.

    Parameters
    ----------
    campaign : CampaignAnalysis
        The trials, the fit and what it misses.
    units : mapping of str to Unit
        Units of display: `SI_UNITS`, or `PAPER_UNITS` for kgf and mm.

    Returns
    -------
    str
        A whole page, with its style and its pictures inside.

    """
    # The import of jinja2 takes a while, and most commands make no report.
    from hapticvision_ros.report.templating import template_environment

    environment = template_environment()
    sections = [
        environment.get_template(f'{name}.html.j2').render(fill(campaign, units))
        for name, fill in SECTIONS
    ]
    style = environment.get_template('style.css').render()
    page = environment.get_template('page.html.j2')
    return page.render(title=TITLE, style=style, sections=sections) + '\n'


def write_report(path: Path, campaign: CampaignAnalysis, units: UnitSystem = SI_UNITS) -> None:
    """
    Write the report, so that a reader finds the old page or the new one and nothing in between.

    Parameters
    ----------
    path : Path
        The HTML file; its folder is made if it is not there.
    campaign : CampaignAnalysis
        The trials, the fit and what it misses.
    units : mapping of str to Unit
        Units of display: `SI_UNITS`, or `PAPER_UNITS` for kgf and mm.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    page = render(campaign, units)
    try:
        write_whole(path.parent, [(path.name, as_bytes(page))])
    except OSError as error:
        raise InputError(
            f'cannot write the report {path}: {error.strerror}; choose another --out.'
        ) from error
