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

"""What goes wrong, told in one sentence: what, where, and what to do about it."""


class HapticVisionError(Exception):
    """
    Base of the errors that a user can do something about.

    The message is one sentence that says what is wrong, where, and what to do. The command line
    prints it on standard error and exits with `exit_code`; anything that is not a
    `HapticVisionError` is a defect of this package.
    """

    exit_code = 2

    def __str__(self) -> str:
        """Return the message in one line, whatever a damaged file calls its topics."""
        said = super().__str__()
        return ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in said)


class InputError(HapticVisionError):
    """A file, a topic or an argument cannot be used."""


class UsageError(HapticVisionError):
    """The command line asks for something that does not exist or does not fit together."""


class DeviceError(HapticVisionError):
    """A device does not answer, or answers something that cannot be used."""
