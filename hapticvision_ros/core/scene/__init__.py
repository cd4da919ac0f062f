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
What stands on the support plane, from clouds and pictures of several viewpoints.

The steps, each in a module of its own: the views are brought together (`registration`) and made
one surface (`surface`), the `plane` and the objects on it are found (`top_view`), the object is
measured (`body`), its plane of symmetry is chosen (`symmetry`), its outline is held against
pictures (`outline`), the push is checked (`stability`), and the place is chosen from which the
dent is to be seen (`viewpoint`). `hapticvision_ros.core.planning` puts them in a row.
"""
