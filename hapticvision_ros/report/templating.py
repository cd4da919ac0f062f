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

"""The templates of the reports, compiled once for a machine."""

from contextlib import suppress
import os
from pathlib import Path

from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined
from jinja2.bccache import Bucket


class _Kept(FileSystemBytecodeCache):
    """A cache whose loss is no reason to lose a report, as on a full disk."""

    def dump_bytecode(self, bucket: Bucket) -> None:
        with suppress(OSError):
            super().dump_bytecode(bucket)


def template_environment() -> Environment:
    """
    Return the templates of the reports.

    Returns
    -------
    jinja2.Environment
        It keeps what it compiles beside what Python compiles, if that can be written.

    """
    folder = Path(__file__).with_name('__pycache__')
    return Environment(
        loader=PackageLoader('hapticvision_ros.report'),
        bytecode_cache=_Kept(str(folder)) if os.access(folder, os.W_OK) else None,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
