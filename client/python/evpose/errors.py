# SPDX-License-Identifier: Apache-2.0
"""The exceptions of the package. Every error of a server, of the network or of an input is an `EvposeError`.

The class of an error is that of the status code of gRPC. `reason` is the name of a value of the API's enum ErrorReason
(proto/evpose/v1/error_reason.proto), or empty; a program tests these two, not the text.
"""

from __future__ import annotations

from typing import Any, Optional

import grpc

from evpose.rpc import error_details_pb2, status_pb2


class EvposeError(Exception):
    """The base class. `str(error)` states the cause, the place and the remedy.

    code      name of the status code of gRPC, such as "NOT_FOUND"
    reason    name of a value of ErrorReason, such as "SESSION_NOT_FOUND"; "" if the server gave none
    field     path of the wrong field of a request; "" if there is none
    retry_in_s   seconds after which a repetition may succeed; 0 if the server gave none
    """

    code = "UNKNOWN"

    def __init__(self, message: str, *, reason: str = "", field: str = "", retry_in_s: float = 0.0) -> None:
        super().__init__(message)
        self.message = message
        self.reason = reason
        self.field = field
        self.retry_in_s = retry_in_s

    def with_message(self, message: str) -> EvposeError:
        """Returns the same error with another text."""
        return type(self)(message, reason=self.reason, field=self.field, retry_in_s=self.retry_in_s)


class CancelledError(EvposeError):
    """The call was cancelled, on this side or by a proxy."""

    code = "CANCELLED"


class InvalidArgumentError(EvposeError, ValueError):
    """A file, an array or a parameter is wrong. The text names it."""

    code = "INVALID_ARGUMENT"


class DeadlineExceededError(EvposeError):
    """No response arrived within the time limit."""

    code = "DEADLINE_EXCEEDED"


class NotFoundError(EvposeError):
    """A session, a model or a file does not exist."""

    code = "NOT_FOUND"


class AlreadyExistsError(EvposeError):
    """A request_id was used with another configuration."""

    code = "ALREADY_EXISTS"


class PermissionDeniedError(EvposeError):
    """The caller may not do this."""

    code = "PERMISSION_DENIED"


class ResourceExhaustedError(EvposeError):
    """A limit of the server or of the tenant was reached."""

    code = "RESOURCE_EXHAUSTED"


class FailedPreconditionError(EvposeError):
    """The state of a session, of the connection or of an object of this package does not permit the call."""

    code = "FAILED_PRECONDITION"


class AbortedError(EvposeError):
    """Another client has taken the session, or poses are no longer stored."""

    code = "ABORTED"


class UnimplementedError(EvposeError):
    """The server does not have this call."""

    code = "UNIMPLEMENTED"


class InternalError(EvposeError):
    """The server has failed, or violates the protocol."""

    code = "INTERNAL"


class UnavailableError(EvposeError):
    """No server responds."""

    code = "UNAVAILABLE"


class DataLossError(EvposeError):
    """Data were damaged or lost."""

    code = "DATA_LOSS"


class UnauthenticatedError(EvposeError):
    """The token or the certificate is missing, unknown or withdrawn."""

    code = "UNAUTHENTICATED"


_CLASSES = {cls.code: cls for cls in EvposeError.__subclasses__()}
_DETAILS: dict[str, Any] = {
    "google.rpc.BadRequest": error_details_pb2.BadRequest,
    "google.rpc.ErrorInfo": error_details_pb2.ErrorInfo,
    "google.rpc.RetryInfo": error_details_pb2.RetryInfo,
}


def _details(call: Any) -> list[Any]:
    """Returns the messages of google.rpc in the trailing metadata of a call, without those that cannot be read."""
    found = []
    for key, value in call.trailing_metadata() or ():
        if key != "grpc-status-details-bin":
            continue
        try:
            items = status_pb2.Status.FromString(value).details
            for item in items:
                known = _DETAILS.get(item.type_url.rsplit("/", 1)[-1])
                if known is not None:
                    found.append(known.FromString(item.value))
        except Exception:  # protobuf has several classes of errors; the code and the text remain
            continue
    return found


def from_call(call: Any, context: str) -> Optional[EvposeError]:
    """Returns the error with which a call has ended, None for OK. The text begins with `context`."""
    code = call.code()
    if code is grpc.StatusCode.OK:
        return None
    text = call.details() or ""
    error = _CLASSES.get(code.name, EvposeError)(f"{context}: {text}")
    for detail in _details(call):
        if isinstance(detail, error_details_pb2.ErrorInfo):
            error.reason = detail.reason
        elif isinstance(detail, error_details_pb2.RetryInfo):
            error.retry_in_s = detail.retry_delay.seconds + 1e-9 * detail.retry_delay.nanos
        else:
            for violation in detail.field_violations:
                error.field = error.field or violation.field
                if violation.field not in text:
                    error = error.with_message(f"{error.message} ({violation.field}: {violation.description})")
    return error
