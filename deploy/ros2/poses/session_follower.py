# SPDX-License-Identifier: Apache-2.0
"""Follows the poses of a session across outages of the server. It needs no ROS."""

import threading

import evpose
from evpose.stream.retry import Advice, Backoff, advise_on


def choose_session(client, name):
    """Returns the session with this name or, for an empty name, the only one that is being fed. Raises evpose.EvposeError."""
    if name:
        return client.session(name)
    attached = [info.name for info in client.list_sessions() if info.state == "ATTACHED"]
    if len(attached) != 1:
        found = ", ".join(attached) or "none"
        raise evpose.NotFoundError(f"one session that is being fed is needed, but there are {len(attached)} ({found}): give its name")
    return client.session(attached[0])


class SessionFollower:
    """Reads poses, each once and in order, or health, until the session has ended or stop() is called."""

    def __init__(self, session, retry=evpose.RetryOptions(max_outage_s=float("inf"))):
        self.num_skipped = 0  # poses that this reader was too slow for, or that the server no longer had
        self._session = session
        self._retry = retry
        self._stop = threading.Event()
        self._after_seq = 0

    def stop(self):
        """Thread-safe. Ends the methods below at the next message, or at the end of a pause."""
        self._stop.set()

    def skip_stored(self):
        """Leaves out the poses that the session has now, and returns their number. Raises evpose.EvposeError."""
        self._after_seq = self._session.health().poses
        return self._after_seq

    def poses(self, on_pose, max_rate_hz=None, on_outage=None):
        """Calls on_pose(pose) for each pose. Raises evpose.EvposeError if a repetition cannot help; `on_outage` is called with each error
        after which the call is repeated."""
        def follow():
            watch = self._session.watch_poses(self._after_seq, max_rate_hz)
            try:
                for pose in watch:
                    if self._stop.is_set():
                        return
                    self._after_seq = pose.seq
                    on_pose(pose)
            finally:
                self.num_skipped += watch.num_skipped
                watch.close()

        self._repeat(follow, on_outage)

    def health(self, on_health, period_s=1.0, on_outage=None):
        """Calls on_health(health) at once, after each period, and at the end. Raises as poses()."""
        def follow():
            for health in self._session.watch_health(period_s):
                if self._stop.is_set():
                    return
                on_health(health)

        self._repeat(follow, on_outage)

    def _repeat(self, follow, on_outage):
        backoff = Backoff(self._retry)
        while not self._stop.is_set():
            before = self._after_seq
            try:
                follow()
                return
            except evpose.EvposeError as error:
                if self._stop.is_set():
                    return
                if advise_on(error) is not Advice.TRY_AGAIN:
                    raise
                if self._after_seq > before:
                    backoff.reset()
                if on_outage is not None:
                    on_outage(error)
            self._stop.wait(backoff.next())
