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

"""The templates of the reports are kept where that is possible, and render where it is not."""

from hapticvision_ros.report import templating


def test_a_cache_that_cannot_be_written_costs_no_report(tmp_path):
    environment = templating.template_environment()
    environment.bytecode_cache = templating._Kept(str(tmp_path / 'gone'))
    assert environment.get_template('style.css').render()


def test_templates_are_compiled_once(tmp_path):
    environment = templating.template_environment()
    environment.bytecode_cache = templating._Kept(str(tmp_path))
    environment.get_template('style.css')
    assert list(tmp_path.iterdir())
