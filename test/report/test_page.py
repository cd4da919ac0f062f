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


from dataclasses import replace
from pathlib import Path
import re

from hapticvision_ros.core.diagnosis.records import Goes, Leftover, Leftovers
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.pipeline import analyse, analyse_campaign, CampaignAnalysis
from hapticvision_ros.report.findings import findings
from hapticvision_ros.report.leftover import residual_sentences
from hapticvision_ros.report.misses import held_out_sentences, verdicts
from hapticvision_ros.report.page import render, write_report
from hapticvision_ros.report.quantities import PAPER_UNITS, SI_UNITS
from lxml import html
import pytest


@pytest.fixture(scope='module')
def page(campaign: CampaignAnalysis) -> str:
    """Return the report of the campaign."""
    return render(campaign)


@pytest.fixture(scope='module')
def tree(page: str) -> html.HtmlElement:
    """Return the report as a tree."""
    return html.document_fromstring(page)


def text_of(tree: html.HtmlElement) -> str:
    """Return what a person reads, with single spaces."""
    for style in tree.iter('style'):
        style.text = None
    return re.sub(r'\s+', ' ', tree.text_content())


def test_the_page_needs_nothing_from_elsewhere(tree: html.HtmlElement) -> None:
    assert not tree.xpath('//script | //link | //img | //iframe | //object')
    for element in tree.iter():
        for name, value in element.attrib.items():
            if name in ('href', 'src', 'xlink:href'):
                assert value.startswith('#')
    assert '@import' not in html.tostring(tree, encoding='unicode')


def test_identifiers_are_unique_and_links_lead_somewhere(tree: html.HtmlElement) -> None:
    ids = tree.xpath('//@id')
    assert len(ids) == len(set(ids))
    for target in tree.xpath('//a/@href'):
        assert target.removeprefix('#') in ids
    for reference in re.findall(r'url\(#([^)]*)\)', html.tostring(tree, encoding='unicode')):
        assert reference in ids


def test_no_number_is_missing_its_value(tree: html.HtmlElement) -> None:
    assert not re.search(r'\b(nan|none|inf|undefined)\b', text_of(tree).lower())


def test_every_trial_has_its_pictures(campaign: CampaignAnalysis, tree: html.HtmlElement) -> None:
    articles = tree.xpath('//article')
    assert len(articles) == 3
    trials = (*campaign.trials, *campaign.held_out)
    for analysis, article in zip(trials, articles, strict=True):
        pictures = article.xpath('.//*[@role="img"]')
        assert len(pictures) == 2
        for picture in pictures:
            assert analysis.trial.name in picture.get('aria-label')
            assert picture.find('svg') is not None
    assert articles[0].xpath('.//*[@role="img"]')[1].get('aria-label').startswith('Displacement')


def test_every_warning_is_told(campaign: CampaignAnalysis, tree: html.HtmlElement) -> None:
    text = text_of(tree)
    warnings = list(campaign.warnings)
    for analysis in (*campaign.trials, *campaign.held_out):
        warnings += analysis.warnings
    assert len(warnings) > 3
    for warning in warnings:
        assert re.sub(r'\s+', ' ', warning) in text


def test_what_the_data_cannot_tell_stands_with_its_reason(
    campaign: CampaignAnalysis, tree: html.HtmlElement
) -> None:
    reason = campaign.trials[1].paper.K1.reason
    assert reason
    (article,) = tree.xpath('//article[@id="trial-2"]')
    assert f'not identifiable: {reason}' in text_of(article)


def test_names_and_provenance_are_text_and_never_markup(
    campaign: CampaignAnalysis, page: str, tree: html.HtmlElement
) -> None:
    name = campaign.held_out[0].trial.name
    assert '<b>' in name and name in text_of(tree)
    assert '<script>alert(1)</script>' in text_of(tree)
    assert '<script' not in page and '<b>1</b>' not in page


def test_parameters_stand_with_errors_and_units(tree: html.HtmlElement) -> None:
    # K1 of the body is 2000 N/m, its retardation time 0.8 s, its relaxation time 2 s.
    (article,) = tree.xpath('//article[@id="trial-1"]')
    rows = {
        row.xpath('string(th)'): row.xpath('string(td[3])') for row in article.xpath('.//tbody/tr')
    }
    pattern = r'\((?P<value>[\d\u202f.]+) ± [\d\u202f.]+\)\xa0(?P<unit>\S+)'
    for symbol, truth, unit in (
        ('K1', 2000.0, 'N/m'),
        ('C2', 2400.0, 'N·s/m'),
        ('γ', 0.8, 's'),
        ('τ', 2.0, 's'),
        ('H0', 3.0, 'mm'),
    ):
        match = re.fullmatch(pattern, rows[symbol])
        assert match and match['unit'] == unit
        # 1 %: what the issue asks of the paper's method on a simulated body.
        value = float(match['value'].replace('\u202f', ''))
        assert value == pytest.approx(truth, rel=0.01)


def test_the_summary_says_how_far_the_model_misses(
    campaign: CampaignAnalysis, tree: html.HtmlElement
) -> None:
    train = campaign.before.train
    assert train is not None
    miss = train.by_trial['whole', 'force']
    assert miss.percent_of_range is not None
    sentences = verdicts(campaign) + held_out_sentences(campaign)
    assert len(sentences) == 5
    assert f'{miss.rmse:.2f}\xa0N ({miss.percent_of_range:.1f}\xa0% of its range)' in sentences[0]
    summary = text_of(tree.xpath('//section[@id="summary"]')[0])
    for sentence in sentences:
        assert re.sub(r'\s+', ' ', sentence) in summary


@pytest.fixture(scope='module')
def full(diagnosed: CampaignAnalysis) -> html.HtmlElement:
    """Return the report of a diagnosed campaign as a tree."""
    return html.document_fromstring(render(diagnosed))


def test_a_diagnosis_stands_with_all_that_it_says(
    diagnosed: CampaignAnalysis, full: html.HtmlElement
) -> None:
    found = diagnosed.diagnosis
    assert found is not None
    section = text_of(full.xpath('//section[@id="diagnosis"]')[0])
    sentences = findings(found, SI_UNITS)
    assert sentences[0].endswith('explained in part by parallel_spring or springpot.')
    two = replace(
        found, effects=('damage', 'yield_force'), sets=(('damage',), ('yield_force', 'friction'))
    )
    assert findings(two, SI_UNITS)[0].endswith('by damage and by yield_force or friction.')
    assert any(
        s.endswith('accepted in 2; as large a gain as here has p\xa0=\xa00.020.')
        for s in sentences
    )
    assert any('0.200\xa0mm/s, 5.00\xa0mm deep, and hold for 60.0\xa0s' in s for s in sentences)
    assert found.next_trial is not None
    thrice = replace(found, next_trial=replace(found.next_trial, repeats=3))
    (advice,) = (s for s in findings(thrice, SI_UNITS) if s.startswith('Push next at 0.200'))
    assert 'hold for 60.0\xa0s, 3 times: expected to tell' in advice
    assert 'by 120 standard deviations for each (they part' in advice
    again = replace(found.next_trial, separates=('scatter', 'damage'), repeats=4)
    first = findings(replace(found, repeat=again), SI_UNITS)
    assert any(s.startswith('Push again at 0.200') and 'scatter and damage' in s for s in first)
    assert not any(s.startswith('Push next') for s in first)
    names = '4 320', '0.987', 'damage', 'not refitted'
    for text in (*sentences, *found.not_testable, *found.warnings, *names):
        assert re.sub(r'\s+', ' ', text) in section.replace('\u202f', ' ')
    assert sentences[0] in text_of(full.xpath('//section[@id="summary"]')[0])
    (accepted,) = full.xpath('//tr[@class="accepted"]/th')
    assert 'parallel_spring' in accepted.text_content()


def test_effects_that_are_named_are_explained(
    tree: html.HtmlElement, full: html.HtmlElement
) -> None:
    rows = full.xpath('//section[@id="effects"]//tbody/tr')
    names = [row.get('id').removeprefix('effect-') for row in rows]
    # Accepted, alike, ranked and not testable ones, in the order of the library.
    known = ['parallel_spring', 'springpot', 'damage', 'ageing', 'clock_offset']
    assert names == known
    spring = text_of(rows[0])
    for effect in (BY_NAME['parallel_spring'],):
        assert {effect.title, effect.signature, effect.validity} <= set(
            map(str.strip, rows[0].itertext())
        )
        assert all(each.meaning in spring for each in effect.parameters)
    # Nothing is named where the model was fixed.
    assert not tree.xpath('//section[@id="effects"]')


def test_parameters_stand_before_and_after_with_their_shift(
    diagnosed: CampaignAnalysis, full: html.HtmlElement
) -> None:
    after = diagnosed.after
    assert after is not None
    old, new = diagnosed.before.parameters['K1'].value, after.parameters['K1'].value
    assert old is not None and new is not None
    tables = full.xpath('//section[@id="parameters"]//table')
    rows = {row.xpath('string(th)'): row for row in tables[1].xpath('.//tbody/tr')}
    assert set(rows) == {'K1', 'C1', 'C2', 'Kp'}
    cells = [cell.text_content() for cell in rows['K1'].xpath('td')]
    assert 'N/m' in cells[0] and 'N/m' in cells[1]
    shift = float(cells[2].removesuffix('\xa0%').replace('\u2212', '-').replace('\u202f', ''))
    assert shift == pytest.approx(100.0 * (old / new - 1.0), rel=0.01)
    assert rows['Kp'].xpath('string(td[1])') == ''


def test_errors_stand_by_phase_and_trial_before_and_after_seen_and_unseen(
    diagnosed: CampaignAnalysis, full: html.HtmlElement
) -> None:
    force, height, change = full.xpath('//section[@id="errors"]//table')
    rows = {
        row.xpath('string(th)'): [cell.text_content() for cell in row.xpath('td')]
        for row in force.xpath('.//tbody/tr')
    }
    names = [one.trial.name for one in (*diagnosed.trials, *diagnosed.held_out)]
    assert list(rows)[:4] == ['All', 'approach', 'push', 'hold'] and list(rows)[-3:] == names
    assert all(len(cells) == 12 for cells in rows.values())
    assert all(rows['All']) and all(rows['whole'][:6]) and not any(rows['whole'][6:])
    assert all(rows[names[-1]][6:])
    # The trial without height has no row among the heights.
    assert 'blind' not in height.text_content()
    changes = {
        row.xpath('string(th)'): [cell.text_content() for cell in row.xpath('td')]
        for row in change.xpath('.//tbody/tr')
    }
    assert [*changes][:: len(changes) - 1] == ['All', names[-1]]
    assert all(len(cells) == 2 for cells in changes.values())
    assert '±' in changes['All'][0] and '±' in changes['hold'][0]


def test_each_model_has_its_own_row_of_residuals(full: html.HtmlElement) -> None:
    labels = [''.join(node.itertext()).strip() for node in full.xpath('//article[1]//text')]
    assert {'Before [N]', 'After [N]', 'Before [mm]', 'After [mm]'} <= set(labels)
    assert {'three-element', 'three-element+parallel_spring'} <= set(labels)


def test_the_page_of_a_diagnosis_has_no_number_without_a_value(full: html.HtmlElement) -> None:
    text = re.sub(r'told from it none', '', text_of(full).lower())
    assert not re.search(r'\b(nan|inf|undefined)\b', text)


def test_the_papers_units_on_request(campaign: CampaignAnalysis) -> None:
    text = text_of(html.document_fromstring(render(campaign, PAPER_UNITS)))
    assert 'kgf/mm' in text and 'Force [kgf]' in text and 'N/m' not in text


def test_a_trial_stays_below_its_size(page: str) -> None:
    # 300 kB a trial.
    assert len(page.encode()) < 3 * 300_000


def test_sections_stand_in_their_order(tree: html.HtmlElement) -> None:
    assert tree.xpath('//section/@id') == [
        'summary',
        'diagnosis',
        'parameters',
        'errors',
        'residual',
        'caveats',
        'trials',
        'provenance',
        'method',
    ]
    method = text_of(tree.xpath('//section[@id="method"]')[0])
    for number in (1, 4, 9, 10, 12, 13):
        assert f'({number})' in method


def test_what_is_left_is_told_before_and_after_with_a_picture(diagnosed: CampaignAnalysis) -> None:
    tree = html.document_fromstring(render(diagnosed))
    (section,) = tree.xpath('//section[@id="residual"]')
    heads = [text_of(each) for each in section.xpath('.//h3')]
    assert heads == ['Force', 'Displacement height']
    assert len(section.xpath('.//figure//svg')) >= 2
    for table in section.xpath('.//table'):
        models = [text_of(each).strip() for each in table.xpath('.//th[@scope="colgroup"]')]
        assert [name.replace('\u200b', '') for name in models] == [
            'three-element',
            'three-element+parallel_spring',
        ]
        rows = [text_of(each).strip() for each in table.xpath('.//tbody//th')]
        assert rows[0] == 'All'
        assert {'push', 'hold', 'recover', 'whole'} <= set(rows)
        assert len(table.xpath('.//tbody/tr[1]/td')) == 12
    assert 'correlation time' in text_of(section)


def _left(**changes: object) -> Leftover:
    plain = Leftover(400, 1.01, 0.02, 0.4, 0.6, 0.03, Goes(0.1, 0.0, 0.4), None, None)
    return replace(plain, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    'left, said, unsaid',
    [
        (_left(), ['1.0 times its noise; nothing in it tells it from white noise'], ['goes']),
        (
            _left(size=18.0, neighbours=0.92, white=1e-9),
            ['18 times its noise; it is not white (one mean goes with the next by 0.92).'],
            ['smooth', 'goes with the depth'],
        ),
        (_left(smooth=1e-5, share=0.87), ['smooth over the phases by 87\u00a0%'], ['not white']),
        (
            _left(speed=Goes(-0.36, 0.512, 1e-9), depth=Goes(0.4, -0.004, 1e-4)),
            [
                'with the speed of the tool by \u22120.36 (0.51\u00a0s later)',
                'depth of the tool by 0.40 (0.0040\u00a0s earlier)',
            ],
            ['order'],
        ),
        (
            _left(order=Goes(0.91, 0.0, 1e-5)),
            ['with the order of the trials by 0.91'],
            ['depth', 'speed'],
        ),
        (_left(size=1.3), ['1.3 times its noise; nothing but its size tells it'], ['nothing in']),
        (_left(white=None, size=2.0), ['too few means of samples'], ['nothing']),
        # By chance, with so few.
        (_left(blocks=64, depth=Goes(0.5, 0.0, 0.01)), ['nothing in it'], []),
    ],
)
def test_what_is_left_is_told_in_words_where_it_is_beyond_chance(
    campaign: CampaignAnalysis, left: Leftover, said: list[str], unsaid: list[str]
) -> None:
    assert campaign.before.left is not None
    noise = campaign.before.left.noise
    model = replace(campaign.before, left=Leftovers(noise, {'force': left}, {}, {}, ()))
    (sentence,) = residual_sentences(replace(campaign, before=model, after=None), SI_UNITS)
    assert sentence.startswith('What the three-element model leaves of the force, whitened, is ')
    assert all(one in sentence for one in said)
    assert not any(one in sentence for one in unsaid)


def test_a_trial_that_no_model_could_be_fitted_to_still_has_its_page(
    campaign: CampaignAnalysis,
) -> None:
    trial = campaign.trials[0].trial
    calm = replace(trial, force=replace(trial.force, value=0.0 * trial.force.value + 0.3))
    text = text_of(html.document_fromstring(render(analyse_campaign([analyse(calm)]))))
    assert 'could not be compared' in text and 'not identifiable' in text
    assert not re.search(r'\b(nan|none|inf)\b', text.lower())


def test_the_file_is_replaced_whole(campaign: CampaignAnalysis, tmp_path: Path) -> None:
    path = tmp_path / 'new' / 'report.html'
    write_report(path, campaign)
    assert path.read_text(encoding='utf-8').endswith('</html>\n')
    assert [file.name for file in path.parent.iterdir()] == ['report.html']


def test_a_failed_report_leaves_the_old_one(
    campaign: CampaignAnalysis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / 'report.html'
    path.write_text('old')

    def full(*_: object) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(Path, 'replace', full)
    with pytest.raises(InputError, match='No space left on device'):
        write_report(path, campaign)
    assert [file.name for file in tmp_path.iterdir()] == ['report.html']
    assert path.read_text() == 'old'
