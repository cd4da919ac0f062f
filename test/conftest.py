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


"""What holds for all tests."""

import os
import signal

# Read when numpy is imported, here and by the processes that tests start: the matrices are small,
# and threads inside each product would only get into each other's way.
os.environ.setdefault('OMP_NUM_THREADS', '1')

# A shell that starts the tests in the background has them ignore SIGINT, and every process that a
# test starts and interrupts would ignore it as well, and never end.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
