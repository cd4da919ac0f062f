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

"""Where the package's shared files are: configuration, launch files, message pages."""

from pathlib import Path

from hapticvision_ros.core.errors import InputError

NAME = 'hapticvision_ros'


def share_folder() -> Path:
    """
    Return the folder that holds ``config/`` and ``launch/`` of this package.

    A source checkout (also an editable or ``--symlink-install`` one) holds them beside the
    package; an installed package has them under ``share/`` of the prefix that its modules lie in:
    a virtual environment, a colcon workspace, ``/opt/ros/<distribution>`` or ``~/.local``.

    Returns
    -------
    pathlib.Path
        The folder, which exists.

    Raises
    ------
    InputError
        If the package was installed without its shared files.

    """
    package = Path(__file__).resolve().parent
    checkout = package.parent
    if (checkout / 'package.xml').is_file() and (checkout / 'config').is_dir():
        return checkout
    for prefix in checkout.parents:
        share = prefix / 'share' / NAME
        if (share / 'config').is_dir():
            return share
    raise InputError(
        f'No share/{NAME} with the configuration files beside {package}: install the package '
        'again with pip or colcon.'
    )
