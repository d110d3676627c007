# SPDX-License-Identifier: Apache-2.0
"""What the nodes in events/ and poses/ share: the connection by their parameters, and the thread that works beside ROS."""

import pathlib
import sys
import threading

import rclpy

import evpose


def connect(settings):
    """Connects by the parameters server, token_file, tls_ca, tls_certificate and tls_key. Raises evpose.EvposeError and OSError."""
    tls = None
    names = ("tls_ca", "tls_certificate", "tls_key")
    if any(settings[name] for name in names):
        tls = evpose.Tls(*(settings[name] or None for name in names))
    path = settings["token_file"]
    token = (lambda: pathlib.Path(path).read_text().strip()) if path else None
    return evpose.connect(settings["server"], tls=tls, token=token)


def run(make_node, name):
    """Runs a node until its work has ended or ROS shuts down: node.work() in a thread of its own, which node.stop() ends. Exits with
    the reason, after `name`, if the node cannot be made or its work fails."""
    rclpy.init()
    try:
        node = make_node()
    except (evpose.EvposeError, OSError) as error:
        sys.exit(f"{name}: {error}")
    failures = []

    def work():
        try:
            node.work()
        except Exception as error:  # of any kind: a node whose work has ended must not run on
            # Publishing fails once ROS has shut down, which is no failure of the node.
            if isinstance(error, evpose.EvposeError) or rclpy.ok():
                failures.append(error)
        rclpy.try_shutdown()

    thread = threading.Thread(target=work)
    thread.start()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    finally:  # also after an error in a callback: the thread would keep the process
        node.stop()
        thread.join()
    for error in failures:
        if not isinstance(error, evpose.EvposeError):
            raise error
        sys.exit(f"{name}: {error}")
