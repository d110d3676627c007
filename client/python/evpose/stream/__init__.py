# SPDX-License-Identifier: Apache-2.0
"""One session's events and poses, over streams that break and are re-established."""
