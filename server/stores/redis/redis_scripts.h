// SPDX-License-Identifier: Apache-2.0

// What a store does in Redis, each at once and wholly: Lua, run there.
//
// Keys, all beginning with "evpose:":
//   fencing         the last fencing number
//   sessions        a set of names
//   ended           a sorted set of the names of those that have ended, by microseconds since 1970
//   session:NAME    a hash: fencing, commit, next, kept (numbers); record, lifecycle, checkpoint (sealed)
//   poses:NAME      a stream; an entry's ID is FIRST-LAST of its poses, its only field `b` their bytes (sealed)
//   models          a set of NAME\nTENANT
//   model:NAME\nTENANT   a hash: header, bytes (sealed)
#pragma once

namespace evpose::server {

struct RedisScript {
  const char* source;
};

// KEYS session, sessions, fencing. ARGV name, record, lifecycle, safety_ttl_ms. The fencing number; 0 when it exists.
extern const RedisScript kRedisCreate;
// KEYS session, poses, fencing. ARGV "1" to take it, else only to read, safety_ttl_ms, a pose, the one after it. Nil
// when it does not exist, else fencing, next, kept, record, lifecycle, checkpoint, the entries of the stream with poses
// after that one.
extern const RedisScript kRedisRead;
// KEYS session, poses, ended. ARGV name, fencing, commit number, first pose to replace, kept, ended_at_us or "",
// safety_ttl_ms, max_segments, checkpoint or "", lifecycle or "" (sealed ones are never empty), then first, last, bytes
// of each segment. OK, NOTFOUND, FENCED, or STALE when a later commit was written.
extern const RedisScript kRedisCommit;
// KEYS session, poses, ended, sessions. ARGV name, fencing or "" for whoever holds it. 0 when another holds it, else 1.
extern const RedisScript kRedisDelete;
// KEYS ended, sessions. ARGV microseconds or "+inf", how many at most, "evpose:session:", "evpose:poses:". Deletes
// those that ended before, oldest first. Their names.
extern const RedisScript kRedisDeleteEnded;
// KEYS model, models. ARGV member, header, bytes.
extern const RedisScript kRedisPutModel;
// KEYS model, models. ARGV member.
extern const RedisScript kRedisDeleteModel;

}  // namespace evpose::server
