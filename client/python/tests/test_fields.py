#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares the package with the messages, enumerations and calls of proto/evpose/v1. What is added there fails these tests until it has a
place in the package, or is listed here with the reason why it has none."""

import re
import unittest

import numpy as np
from testing import ROOT, evpose

from evpose import convert, poses
from evpose.types import SessionConfig
from evpose.v1 import (admin_service_pb2, error_reason_pb2, event_image_pb2, geometry_pb2, mesh_pb2, model_service_pb2, session_pb2,
                       session_service_pb2, track_pb2)

MODULES = (admin_service_pb2, error_reason_pb2, event_image_pb2, geometry_pb2, mesh_pb2, model_service_pb2, session_pb2, session_service_pb2,
           track_pb2)

# Messages without a type in the package, with the reason. The messages in them need none either.
WITHOUT_TYPE = {
    "GetServerInfoRequest": "has no fields",
    "DrainRequest": "see the call", "DrainResponse": "see the call",
    "SetLogLevelRequest": "see the call", "SetLogLevelResponse": "see the call",
    "EventImage": "see WatchEvents", "WatchEventsRequest": "see WatchEvents", "WatchEventsResponse": "see WatchEvents",
    "GetModelGeometryRequest": "see GetModelGeometry", "ModelGeometry": "see GetModelGeometry",
    "ObjectOutline": "see WatchEvents",
    "Mesh": "a model file is sent as it is", "MeshFace": "see Mesh", "MeshEdge": "see Mesh",
    "UploadModelRequest": "arguments of Client.upload_model()",
    "GetModelRequest": "argument of Client.get_model()", "DeleteModelRequest": "argument of Client.delete_model()",
    "ListModelsRequest": "Client.list_models() reads all pages", "ListModelsResponse": "Client.list_models() reads all pages",
    "CreateSessionRequest": "arguments of Client.create_session()", "CreateSessionResponse": "Client.create_session() returns a Session",
    "GetSessionRequest": "argument of Client.get_session()", "DeleteSessionRequest": "argument of Session.delete()",
    "ListSessionsRequest": "Client.list_sessions() reads all pages", "ListSessionsResponse": "Client.list_sessions() reads all pages",
    "WatchPosesRequest": "arguments of Session.watch_poses()", "WatchPosesResponse": "attributes of PoseWatch",
    "WatchHealthRequest": "argument of Session.watch_health()", "WatchHealthResponse": "Session.watch_health() yields Health",
    "TrackRequest": "the stream sends it", "TrackResponse": "the stream receives it; its notices are compared below",
}
# Calls that the package does not make, with the reason.
WITHOUT_CALL = {
    "Drain": "for operators: evpose sessions drain",
    "SetLogLevel": "for operators: evpose server log-level",
    "GetModelGeometry": "for views: evpose view and evpose watch --out poses.mcap",
    "WatchEvents": "for views: evpose view and evpose watch --out poses.mcap",
}
ENUMS = {
    "EventEncoding": evpose.Encoding, "OverloadPolicy": evpose.Overload, "TrackState": evpose.TrackState, "Estimator": evpose.Estimator,
    "ModelSurface": evpose.Surface,
}
# The package gives the values of these enumerations as texts, which are the names in the API. Values that are added later have texts, too.
TEXTS = {"StoreKind", "ModelFormat", "Kind", "LensModel", "DropReason", "InitializationStatus", "LossCause", "SessionState", "ErrorReason"}
UNUSED = {"LogLevel": "see SetLogLevel", "MeshCurve": "see Mesh", "MeshShape": "see Mesh", "Encoding": "of EventImage, see WatchEvents"}


def leaves(descriptor, prefix=""):
    """Yields the paths of the fields that are no messages; times and durations are not divided."""
    for field in descriptor.fields:
        path = prefix + field.name
        message = field.message_type
        if message is None or message.full_name.startswith("google.protobuf."):
            yield path
        else:
            yield from leaves(message, path + ".")


def change(message, path):
    """Gives one field another value than it has; of a repeated one, the first element."""
    name, _, rest = path.partition(".")
    field = message.DESCRIPTOR.fields_by_name[name]
    value = getattr(message, name)
    is_repeated = field.label == field.LABEL_REPEATED
    if rest:
        change((value[0] if value else value.add()) if is_repeated else value, rest)
    elif field.message_type is not None:
        value.FromSeconds(5)
    else:
        numbers = {field.CPPTYPE_ENUM: 1 if value == 2 else 2, field.CPPTYPE_STRING: b"5" if field.type == field.TYPE_BYTES else "5", field.CPPTYPE_BOOL: True}
        new = numbers.get(field.cpp_type, 5)
        if not is_repeated:
            setattr(message, name, new)
        elif value:
            value[0] = new
        else:
            value.append(new)


def with_parents(message, path):
    """Adds the messages in which the field of this path is."""
    name, _, rest = path.partition(".")
    if not rest:
        return
    value = getattr(message, name)
    if message.DESCRIPTOR.fields_by_name[name].label == message.DESCRIPTOR.fields_by_name[name].LABEL_REPEATED:
        value = value[0] if value else value.add()
    else:
        value.SetInParent()
    with_parents(value, rest)


def lost_fields(message, read):
    """Returns the paths of the fields of `message` that do not change the result of `read`. A `read` that raises ValueError has read the
    field."""
    lost = []
    for path in leaves(message.DESCRIPTOR):
        before, after = type(message)(), type(message)()
        before.CopyFrom(message)
        with_parents(before, path)
        after.CopyFrom(before)
        change(after, path)
        try:
            if repr(read(before)) == repr(read(after)):
                lost.append(path)
        except ValueError:
            pass
    return lost


def messages_in(descriptor):
    """Yields a message and those in its fields."""
    yield descriptor
    for field in descriptor.fields:
        if field.message_type is not None:
            yield from messages_in(field.message_type)


def full_config():
    """A configuration in which every field has a value other than the default."""
    transform = evpose.Transform(np.array([0.25, -0.5, 2.0]), np.array([0.5, -0.5, 0.5, 0.5]))
    tracked = evpose.TrackedObject("models/1", "left", transform, np.array([0.5, 0.5, 0.5, 0.5]))
    camera = evpose.Camera(640, 480, 600.5, 601.0, 319.5, 239.5, (1e-3, 2e-3, 3e-3, 4e-3), "fisheye")
    return SessionConfig(evpose.Encoding.EVT21, camera, (tracked,), evpose.Overload.LATEST, 0.025, evpose.Estimator.STATIC_S,
                         evpose.SensorProfile(0.5, 0.25, 0.125, 100.0, 30.0, 0.5), 2500.0)


def a_model():
    model = model_service_pb2.Model()
    model.continuous_symmetry.kind = geometry_pb2.ContinuousSymmetry.KIND_AXIS
    return model


def a_pose():
    pose = session_pb2.Pose(pose_seq=1, state=evpose.TrackState.TRACKING)
    pose.camera_from_object.rotation.w = 1.0
    pose.covariance.upper_triangle.extend([0.0] * 21)
    pose.alternatives.add().camera_from_object.rotation.w = 1.0
    return pose


class FieldsTest(unittest.TestCase):
    def test_every_field_of_a_response_is_read(self):
        for message, read in (
                (admin_service_pb2.ServerInfo(), convert.server_from_message), (a_model(), convert.model_from_message),
                (session_pb2.SessionHealth(), convert.health_from_message), (a_pose(), poses.pose_from_message)):
            self.assertEqual(lost_fields(message, read), [], message.DESCRIPTOR.name)
        # A field that makes a configuration invalid makes it None, whether it is read or not.
        lost = lost_fields(session_pb2.Session(), convert.session_from_message)
        self.assertEqual([path for path in lost if not path.startswith("config.")], [])

    def test_every_field_of_a_notice_is_read(self):
        for field in track_pb2.TrackResponse.Notice.DESCRIPTOR.fields:
            notice = track_pb2.TrackResponse.Notice()
            getattr(notice, field.name).SetInParent()
            self.assertIsNotNone(convert.notice_from_message(notice), field.name)
            lost = lost_fields(notice, convert.notice_from_message)
            self.assertEqual([path for path in lost if path.startswith(field.name + ".")], [])

    def test_every_field_of_a_configuration_is_written_and_read(self):
        message = full_config().to_proto()
        for path in leaves(session_pb2.SessionConfig.DESCRIPTOR):
            value = message
            for name in path.split("."):
                value = getattr(value, name)
                if hasattr(value, "append"):
                    value = value[0]
            self.assertTrue(value.ByteSize() if hasattr(value, "ByteSize") else value, path)
        read = convert.config_from_message(message)
        self.assertIsNotNone(read)
        self.assertEqual(read.to_proto(), message)
        unknown = session_pb2.SessionConfig()
        unknown.CopyFrom(message)
        unknown.tracker.estimator = 99
        self.assertIsNone(convert.config_from_message(unknown))

    def test_every_message_has_a_type_or_a_reason(self):
        typed = {each.name for message in (admin_service_pb2.ServerInfo, model_service_pb2.Model, session_pb2.Session, session_pb2.Pose)
                 for each in messages_in(message.DESCRIPTOR)}
        messages = {name for module in MODULES for name in module.DESCRIPTOR.message_types_by_name}
        self.assertEqual(sorted(messages - typed - set(WITHOUT_TYPE)), [], "has neither a type in the package nor a reason here")
        self.assertEqual(sorted(set(WITHOUT_TYPE) - (messages - typed)), [], "has a type, or does not exist")

    def test_every_call_is_made_or_has_a_reason(self):
        methods = {method.name for module in MODULES for service in module.DESCRIPTOR.services_by_name.values() for method in service.methods}
        source = "".join(path.read_text() for path in sorted((ROOT / "client/python/evpose").rglob("*.py")))
        made = {method for method in methods if re.search(rf'[/"]{method}"', source)}
        self.assertEqual(sorted(methods - made), sorted(WITHOUT_CALL))

    def test_every_value_of_an_enumeration_has_a_name(self):
        def enums_in(descriptor):
            yield from descriptor.enum_types
            for nested in descriptor.nested_types:
                yield from enums_in(nested)

        found = {}
        for module in MODULES:
            found.update(module.DESCRIPTOR.enum_types_by_name)
            found.update({each.name: each for message in module.DESCRIPTOR.message_types_by_name.values() for each in enums_in(message)})
        self.assertEqual(sorted(set(found) - set(ENUMS) - TEXTS - set(UNUSED)), [], "is neither a type nor a text of the package")
        for name, enum in ENUMS.items():
            values = {value.number for value in found[name].values if value.number != 0}
            self.assertEqual({int(each) for each in enum} - {0}, values, name)


if __name__ == "__main__":
    unittest.main()
