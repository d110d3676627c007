// SPDX-License-Identifier: Apache-2.0

// The operations of the Redis store as Lua scripts, which Redis executes atomically.
//
// Keys, all with the prefix "evpose:". The values of record, lifecycle, checkpoint, b, header and bytes have checksums
// (checked_records.h).
//   fencing         the last fencing number
//   sessions        a set of the names of all sessions
//   owners          a hash: by the name of each session its TENANT\nREQUEST_ID; both empty if its record is damaged
//   tenants         a sorted set of TENANT\nNAME of all sessions, all with the score 0 and so in the order of the text
//   requests        a hash: by TENANT\nREQUEST_ID the name of the session
//   lifecycle_writes   a sorted set of the names of all sessions, by the number of the latest write of the lifecycle
//   ended           a sorted set of the names of ended sessions, by microseconds since 1970
//   session:NAME    a hash: fencing, commit, next, kept (numbers); holder (with `fencing` the token of the lease; a
//                   session of an earlier version has none until it is taken); record, lifecycle, checkpoint
//   poses:NAME      a stream; the ID of an entry is FIRST-LAST of its poses, its only field `b` their bytes
//   models          a set of NAME\nTENANT
//   model:NAME\nTENANT   a hash: header, bytes
#pragma once

#include <string>

namespace evpose::server {

struct RedisScript {
  std::string source;
};

// Creates a session. KEYS: session, sessions, fencing, owners, tenants, requests, lifecycle_writes. ARGV: name, record,
// lifecycle, safety_ttl_ms, holder, tenant, request_id, "evpose:session:". Returns the fencing number, or 0 when the
// session, or one of the same request_id, exists.
extern const RedisScript kRedisCreate;
// Adds a session that an earlier version created to owners, tenants, requests and lifecycle_writes. KEYS: these. ARGV:
// name, tenant, request_id.
extern const RedisScript kRedisIndex;
// Reads a session, and takes it if asked. KEYS: session, poses, fencing. ARGV: "1" to take the session or "0",
// safety_ttl_ms, the number of a pose, that number + 1, holder. Returns nil when the session does not exist, else
// fencing, next, kept, record, lifecycle, checkpoint and the entries of the stream that have a later pose.
extern const RedisScript kRedisRead;
// Writes a commit. KEYS: session, poses, ended, lifecycle_writes. ARGV: name, fencing, commit number, first pose to
// replace, kept, ended_at_us or "", safety_ttl_ms, max_segments, checkpoint or "", lifecycle or "" (an encoded record
// is never empty), holder, number of the last commit that ended with OK, then first, last, bytes of each segment.
// Returns OK, NOTFOUND, FENCED, STALE when a later commit has been written, or LOST when Redis has lost the lease or
// commits of it.
extern const RedisScript kRedisCommit;
// Deletes a session. KEYS: session, poses, ended, sessions, owners, tenants, requests, lifecycle_writes. ARGV: name,
// fencing or "" for any holder, holder. Returns OK, FENCED or LOST.
extern const RedisScript kRedisDelete;
// Deletes the sessions that ended before a time, beginning with the earliest end. KEYS: ended, sessions, owners,
// tenants, requests, lifecycle_writes. ARGV: microseconds or "+inf", maximum number, "evpose:session:",
// "evpose:poses:". Returns their names.
extern const RedisScript kRedisDeleteEnded;
// Adds a model unless it exists. KEYS: model, models. ARGV: member of the set, header, bytes. Returns 1 if it was
// added.
extern const RedisScript kRedisPutModel;
// Deletes a model. KEYS: model, models. ARGV: member of the set. Returns 1 if it existed.
extern const RedisScript kRedisDeleteModel;

}  // namespace evpose::server
