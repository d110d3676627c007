#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Tokens and certificates: who is turned away, when open streams end, and what the operator sees of it."""

import subprocess
import unittest

import grpc

import server
from api import client, failure_of, refusal
from hostile_models import CUBE, padded_cube
from test_uploads import end_of, open_upload, reason_of_header


def is_unauthenticated(api):
    try:
        api("GetServerInfo")
        return False
    except grpc.RpcError as error:
        return error.code() == grpc.StatusCode.UNAUTHENTICATED


class TokenTest(server.AdversaryTest):
    def withdraw(self, remaining):
        """Removes all tokens except those of `remaining` while mallory has a Track and three Watch streams and an upload open."""
        # An upload may be silent for --attach-timeout.
        running = self.serve("--attach-timeout", str(server.PATIENCE_S), "--upload-timeout", str(server.PATIENCE_S),
                             "--max-model-bytes", str(1 << 20), "--tenant-max-model-bytes", str(1 << 20), tenants=("alice", "mallory"))
        mallory, alice = client(self, running, "mallory"), client(self, running, "alice")
        created = mallory.create(mallory.upload(CUBE).name)
        stream, _ = mallory.attach(created)
        watchers = [mallory.watch(name, session=created.session.name) for name in ("WatchHealth", "WatchPoses", "WatchEvents")]
        next(watchers[0])
        upload = open_upload(mallory, 900_000)
        upload.send(chunk=padded_cube(899_999, 1))
        server.poll(lambda: reason_of_header(mallory, 200_000) == "TENANT_QUOTA", "bytes of the upload that have arrived")
        server.write_tokens(self.directory / "tokens", remaining)
        server.poll(lambda: is_unauthenticated(mallory), "a refused call")
        self.assertEqual(stream.failure().code, "UNAUTHENTICATED")
        for watcher in watchers:
            self.assertEqual(refusal(list, watcher).code, "UNAUTHENTICATED")
        failure = end_of(upload)
        self.assertEqual((failure.code, failure.reason), ("UNAUTHENTICATED", "ACCESS_WITHDRAWN"))
        self.assertEqual(is_unauthenticated(alice), "alice" not in remaining)

    def test_open_streams_end_when_their_token_is_withdrawn(self):
        self.withdraw(["alice"])

    def test_a_file_without_tokens_admits_nobody(self):
        self.withdraw([])

    def test_an_empty_file_admits_nobody(self):
        running = self.serve(tenants=("alice",))
        alice = client(self, running, "alice")
        alice("GetServerInfo")
        (self.directory / "tokens").write_bytes(b"")
        server.poll(lambda: is_unauthenticated(alice), "a refused call")

    def test_wrong_tokens_are_counted_and_logged_at_a_bounded_rate(self):
        running = self.serve(tenants=("alice",))
        for i in range(5):
            guess = client(self, running, token=f"guess{i}")
            for _ in range(100):
                self.assertEqual(refusal(guess, "GetServerInfo").reason, "BAD_TOKEN")
        self.assertEqual(running.metric("evpose_authentication_failures_total"), 500)
        lines = [line for line in running.log().splitlines() if "authentication_failed" in line]
        self.assertTrue(0 < len(lines) < 100, lines)
        self.assertNotIn("guess", running.log())

    def test_odd_tokens_are_refused(self):
        running = self.serve(tenants=("alice",))
        self.assertEqual(refusal(client(self, running), "GetServerInfo").reason, "NO_TOKEN")
        for token in (" ", "x" * 7000, server.token("alice") + "0", server.token("alice").upper()):
            self.assertEqual(refusal(client(self, running, token=token), "GetServerInfo").code, "UNAUTHENTICATED")

    def test_only_operators_drain(self):
        running = self.serve(tenants=("alice", "mallory"), operator="alice")
        mallory = client(self, running, "mallory")
        for name, fields in (("Drain", {}), ("SetLogLevel", {"level": 5})):
            self.assertEqual(refusal(mallory, name, **fields).reason, "NOT_OPERATOR")

    def test_tenants_do_not_see_each_other(self):
        running = self.serve(tenants=("alice", "mallory"), operator="mallory")
        alice, mallory = client(self, running, "alice"), client(self, running, "mallory")
        model = alice.upload(CUBE).name
        created = alice.create(model)
        for name in ("GetSession", "DeleteSession"):
            self.assertEqual(refusal(mallory, name, name=created.session.name).reason, "SESSION_NOT_FOUND")
        for name in ("GetModel", "DeleteModel"):
            self.assertEqual(refusal(mallory, name, name=model).reason, "MODEL_NOT_FOUND")
        self.assertEqual(refusal(mallory.attach, created).reason, "SESSION_NOT_FOUND")
        self.assertEqual(refusal(mallory.create, model).reason, "MODEL_NOT_FOUND")
        self.assertFalse(mallory("ListSessions").sessions or mallory.models())


class TenantLimitTest(server.AdversaryTest):
    """With tokens a tenant may have half of everything unless options say otherwise."""

    def test_sessions(self):
        running = self.serve("--max-sessions", "8", tenants=("alice", "mallory"))
        mallory, alice = client(self, running, "mallory"), client(self, running, "alice")
        created, failure = mallory.create_until_refused(mallory.upload(CUBE).name)
        self.assertEqual((len(created), failure.reason), (4, "TENANT_QUOTA"))
        alice.create(alice.upload(CUBE).name)

    def test_models(self):
        running = self.serve("--max-model-store-bytes", str(4 << 20), "--max-model-bytes", str(1 << 20),
                             tenants=("alice", "mallory"))
        mallory, alice = client(self, running, "mallory"), client(self, running, "alice")
        size = (1 << 19) - (1 << 17)  # four of them fit, with the views and the rest that the server derives from each
        for number in range(4):
            mallory.upload(padded_cube(size, number))
        self.assertEqual(refusal(mallory.upload, padded_cube(size, 4)).reason, "TENANT_QUOTA")
        alice.upload(padded_cube(size, 5))

    def test_watchers(self):
        running = self.serve("--max-streams", "16", tenants=("alice", "mallory"))
        mallory, alice = client(self, running, "mallory"), client(self, running, "alice")
        created = mallory.create(mallory.upload(CUBE).name)
        watchers = [mallory.watch("WatchHealth", session=created.session.name) for _ in range(30)]  # kept until the end
        server.poll(lambda: running.metric("evpose_quota_refusals_total", 'limit="tenant_') == 22, "22 refusals")
        alice.attach(alice.create(alice.upload(CUBE).name))
        reasons = {failure_of(watcher).reason for watcher in watchers if watcher.done()}
        self.assertEqual(reasons, {"TENANT_QUOTA"})  # refused streams do not count for the limit of the server


class CertificateTest(server.AdversaryTest):
    """Client certificates whose common name is the tenant."""

    def openssl(self, *words):
        subprocess.run(["openssl", *words], cwd=self.directory, check=True, capture_output=True)

    def make_certificate(self, name, *subject_and_more):
        self.openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", f"{name}.key",
                     "-out", f"{name}.csr", "-subj", *subject_and_more)
        self.openssl("ca", "-config", "ca.cnf", "-batch", "-notext", "-in", f"{name}.csr", "-out", f"{name}.crt")

    def setUp(self):
        super().setUp()
        (self.directory / "ca.cnf").write_text(
            "[ca]\ndefault_ca = ours\n[ours]\ndatabase = index.txt\nnew_certs_dir = .\nserial = serial\ndefault_md = sha256\n"
            "default_days = 2\ndefault_crl_days = 2\npolicy = any\nunique_subject = no\ncopy_extensions = copy\n"
            "certificate = ca.crt\nprivate_key = ca.key\n[any]\ncommonName = supplied\n")
        (self.directory / "index.txt").touch()
        (self.directory / "serial").write_text("1000\n")
        self.openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2", "-subj",
                     "/CN=authority", "-keyout", "ca.key", "-out", "ca.crt")
        self.make_certificate("server", "/CN=server", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1")
        self.files = ["--tls-cert", self.path("server.crt"), "--tls-key", self.path("server.key"), "--tls-client-ca",
                      self.path("ca.crt")]

    def path(self, name):
        return str(self.directory / name)

    def client_of(self, running, name):
        key, chain, authority = ((self.directory / file).read_bytes() for file in (f"{name}.key", f"{name}.crt", "ca.crt"))
        return client(self, running, credentials=grpc.ssl_channel_credentials(authority, key, chain))

    def test_a_certificate_with_two_names_is_refused(self):
        self.make_certificate("alice", "/CN=alice")
        # A policy of openssl keeps one common name, so this certificate is signed in another way.
        self.openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", "two.key", "-out",
                     "two.csr", "-subj", "/CN=alice/CN=mallory")
        self.openssl("x509", "-req", "-in", "two.csr", "-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2",
                     "-out", "two.crt")
        running = self.serve(*self.files)
        self.client_of(running, "alice")("GetServerInfo")
        self.assertEqual(refusal(self.client_of(running, "two"), "GetServerInfo").reason, "BAD_CERTIFICATE")

    def test_a_revoked_certificate_is_refused(self):
        for name in ("alice", "mallory"):
            self.make_certificate(name, f"/CN={name}")
        self.openssl("ca", "-config", "ca.cnf", "-gencrl", "-out", "list.crl")
        running = self.serve(*self.files, "--tls-client-crl", self.path("list.crl"))
        mallory = self.client_of(running, "mallory")
        created = mallory.create(mallory.upload(CUBE).name)
        stream, _ = mallory.attach(created)
        self.openssl("ca", "-config", "ca.cnf", "-revoke", "mallory.crt")
        self.openssl("ca", "-config", "ca.cnf", "-gencrl", "-out", "list.crl")
        self.assertEqual(stream.failure().code, "UNAUTHENTICATED")
        server.poll(lambda: is_unauthenticated(mallory), "a refused call")
        self.client_of(running, "alice")("GetServerInfo")

    def _end(self, running):
        """Like the method of the base class. The gRPC port requires a certificate here, so that the readiness is read from the HTTP page."""
        if not running.is_ended:
            self.assertEqual(running.page("/readyz")[0], 200)
            self.assertEqual(running.terminate(), 0)


if __name__ == "__main__":
    unittest.main()
