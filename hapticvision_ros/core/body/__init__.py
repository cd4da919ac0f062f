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

"""
The object as a lattice of mass points and links, pressed by a tool: force, dent and bulge in 3D.

A `lattice` is made from a box, a map of heights or a cloud; its `links` carry the chain of the
identified model; a `push` says what the tool does and how tool and support touch;
`simulation.simulate` gives force, height and positions; `calibration` finds the numbers of the
links that give the identified force.
"""
