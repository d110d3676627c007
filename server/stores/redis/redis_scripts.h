// SPDX-License-Identifier: Apache-2.0

// The operations of the Redis store as Lua scripts, which Redis executes atomically. Each script uses only the keys
// that it declares, all of one bucket, and writes only if the bucket is in this group.
//
// Keys, all with the prefix "evpose:" (redis_keys.h). The values of record, lifecycle, checkpoint, b, header and bytes
// have checksums (checked_records.h).
//   {store}         a hash in each group: `id`, which is random and the same in all groups of a store; `name`, the name
//                   of the group; in one group also `groups`, the names of the groups among which the buckets were
//                   divided at first
//   sessions        a text, with which a server without buckets does not start
// and in each bucket, as {bN}:WHAT:
//   bucket          a hash: state: here, moving, leaving, moved or arriving (when a bucket that was moved returns), and
//                   only scripts that move it write unless it is here; to: the group to which it moves or moved; mover:
//                   random, of the program that moves it; epoch: higher after each move; fencing: the last fencing
//                   number. A bucket without it is not here.
//   owners          a hash: by the name of each session its TENANT\nREQUEST_ID
//   tenants         a sorted set of TENANT\nNAME of all sessions, all with the score 0 and so in the order of the text
//   requests        a hash: by TENANT\nREQUEST_ID the name of the session
//   lifecycle_writes   a sorted set of the names of all sessions, by the latest write of the lifecycle: microseconds
//                   since 1970, or one more than the last number of the bucket if that is higher
//   ended           a sorted set of the names of ended sessions, by microseconds since 1970
//   session:NAME    a hash: fencing, commit, next, kept (numbers); holder (with `fencing` the token of the lease);
//                   record, lifecycle, checkpoint
//   poses:NAME      a stream; the ID of an entry is FIRST-LAST of its poses, its only field `b` their bytes
//   models          a set of NAME\nTENANT
//   model:NAME\nTENANT   a hash: header, bytes
#pragma once

#include <string>
#include <vector>

namespace evpose::server {

struct RedisScript {
  std::string source;
};

// Scripts on a session. KEYS: RedisSessionKeys(). All of them fail with the error ELSEWHERE if the bucket is not here.

// Creates a session. ARGV: name, record, lifecycle, safety_ttl_ms, holder, tenant, request_id. Returns the fencing
// number; 0 when the session exists; or the name of another session with the same request_id.
extern const RedisScript kRedisCreate;
// Reads a session, and acquires its lease if asked. ARGV: "1" to acquire it or "0", safety_ttl_ms, the number of a
// pose, that number + 1, holder. Returns nil when the session does not exist, else fencing, next, kept, record,
// lifecycle, checkpoint and the entries of the stream that have a later pose.
extern const RedisScript kRedisRead;
// Writes a commit. ARGV: name, fencing, commit number, first pose to replace, kept, ended_at_us or "", safety_ttl_ms,
// max_segments, checkpoint or "", lifecycle or "" (an encoded record is never empty), holder, number of the last commit
// that ended with OK, then first, last, bytes of each segment. Returns OK, NOTFOUND, FENCED, STALE when a later commit
// has been written, or LOST when Redis has lost the lease or commits of it.
extern const RedisScript kRedisCommit;
// Deletes a session. ARGV: name, fencing or "" for any holder, holder. Returns OK, FENCED or LOST.
extern const RedisScript kRedisDelete;
// Deletes a session if it ended before a time. ARGV: name, microseconds or "+inf". Returns OK or KEPT.
extern const RedisScript kRedisDeleteEnded;

// Scripts on a model. KEYS: RedisModelKeys(). ELSEWHERE as above.

// Adds a model or replaces it. ARGV: member of the set, header, bytes.
extern const RedisScript kRedisPutModel;
// Deletes a model. ARGV: member of the set.
extern const RedisScript kRedisDeleteModel;

// Makes a bucket unless the group knows it. KEYS: the state of the bucket. ARGV: epoch.
extern const RedisScript kRedisMakeBucket;

// Scripts that move a bucket from one group to another (redis_move.cc). KEYS: the state of the bucket, and for
// kRedisRestore and kRedisForget another key.

// Begins the move in the first group: the bucket is moving, unless it is leaving already. ARGV: to, mover. Returns
// state, to, epoch and fencing; ELSEWHERE if it is not here. Succeeds also when the memory of Redis is full.
extern const RedisScript kRedisBeginMove;
// Reverts the move in the first group: the state changes from moving to here. ARGV: mover.
extern const RedisScript kRedisRevertMove;
// Changes the state in the first group from moving to leaving, after which the move is only completed. ARGV: mover.
// Returns OK or OTHER.
extern const RedisScript kRedisLeave;
// Writes a value in the other group as DUMP has returned it. ARGV: time to live in ms or 0, value. Returns OK, or HERE
// if the move is complete.
extern const RedisScript kRedisRestore;
// Sets the state in the other group: the bucket is here. ARGV: epoch, fencing. Has no effect if it is known with this
// epoch.
extern const RedisScript kRedisArrive;
// Changes the state in the first group from leaving to moved.
extern const RedisScript kRedisMoved;
// Deletes the other key in the first group if the bucket is moved.
extern const RedisScript kRedisForget;

// Scripts on the record of the store. KEYS: kRedisStoreKey.

// Writes what the record lacks. ARGV: id, name of the group, names of all groups or "". Returns id, name and groups.
extern const RedisScript kRedisJoin;
// Names the only group of a store, which gets further ones. ARGV: name.
extern const RedisScript kRedisName;

// All of the above.
const std::vector<const RedisScript*>& AllRedisScripts();

}  // namespace evpose::server
