// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_scripts.h"

namespace evpose::server {

// When its memory is full, Redis rejects the first write of a script, but no later one. In each script the first write
// is a command that Redis may reject, so that a script is never executed in part.

namespace {

const char* const kCheckBucket = R"lua(
local state = redis.call('HGET', KEYS[1], 'state')
if state ~= 'here' then return redis.error_reply('ELSEWHERE ' .. (state or 'unknown')) end
)lua";

const char* const kSessionKeys = R"lua(
local bucket, session, poses, ended, owners, tenants, requests, lifecycle_writes = unpack(KEYS)
)lua";

const char* const kNoteLifecycleWrite = R"lua(
local function note_lifecycle_write(name)
  local last = redis.call('ZREVRANGE', lifecycle_writes, 0, 0, 'WITHSCORES')[2] or '0'
  local time = redis.call('TIME')
  local now_us = tonumber(time[1]) * 1000000 + tonumber(time[2])
  redis.call('ZADD', lifecycle_writes, string.format('%.0f', math.max(now_us, tonumber(last) + 1)), name)
end
)lua";

const char* const kDeleteSession = R"lua(
local function delete_session(name)
  redis.call('DEL', session, poses)
  redis.call('ZREM', ended, name)
  local owner = redis.call('HGET', owners, name)
  if owner then
    redis.call('ZREM', tenants, string.match(owner, '^[^\n]*\n') .. name)
    if redis.call('HGET', requests, owner) == name then redis.call('HDEL', requests, owner) end
    redis.call('HDEL', owners, name)
  end
  redis.call('ZREM', lifecycle_writes, name)
end
)lua";

// A script on a session, from its parts.
RedisScript SessionScript(const char* functions, const char* body) {
  return {std::string(kCheckBucket) + kSessionKeys + functions + body};
}

RedisScript ModelScript(const char* body) { return {std::string(kCheckBucket) + body}; }

}  // namespace

const RedisScript kRedisCreate = SessionScript(kNoteLifecycleWrite, R"lua(
if redis.call('EXISTS', session) == 1 then return 0 end
local owner = ARGV[6] .. '\n' .. ARGV[7]
if ARGV[7] ~= '' then
  local of_request = redis.call('HGET', requests, owner)
  if of_request then return of_request end
end
local number = redis.call('HINCRBY', bucket, 'fencing', 1)
redis.call('HSET', session, 'fencing', number, 'holder', ARGV[5], 'commit', 0, 'next', 1, 'kept', 1,
  'record', ARGV[2], 'lifecycle', ARGV[3])
redis.call('PEXPIRE', session, ARGV[4])
redis.call('HSET', owners, ARGV[1], owner)
redis.call('ZADD', tenants, 0, ARGV[6] .. '\n' .. ARGV[1])
if ARGV[7] ~= '' then redis.call('HSET', requests, owner, ARGV[1]) end
note_lifecycle_write(ARGV[1])
return number
)lua");

const RedisScript kRedisRead = SessionScript("", R"lua(
if redis.call('EXISTS', session) == 0 then return false end
if ARGV[1] == '1' then
  redis.call('HSET', session, 'fencing', redis.call('HINCRBY', bucket, 'fencing', 1), 'holder', ARGV[5], 'commit', 0)
  redis.call('PEXPIRE', session, ARGV[2])
  redis.call('PEXPIRE', poses, ARGV[2])
end
local values = redis.call('HMGET', session, 'fencing', 'next', 'kept', 'record', 'lifecycle', 'checkpoint')
local begin = ARGV[4]
local across = redis.call('XREVRANGE', poses, ARGV[3], '-', 'COUNT', 1)[1]
if across and tonumber(string.match(across[1], '(%d+)$')) > tonumber(ARGV[3]) then begin = across[1] end
values[7] = redis.call('XRANGE', poses, begin, '+')
return values
)lua");

const RedisScript kRedisCommit = SessionScript(kNoteLifecycleWrite, R"lua(
local held = redis.call('HMGET', session, 'fencing', 'commit', 'kept', 'holder')
if not held[1] then return redis.status_reply('NOTFOUND') end
if tonumber(held[1]) < tonumber(ARGV[2]) then return redis.status_reply('LOST') end
if held[1] ~= ARGV[2] or held[4] ~= ARGV[11] then return redis.status_reply('FENCED') end
if tonumber(held[2]) >= tonumber(ARGV[3]) then return redis.status_reply('STALE') end
if tonumber(held[2]) < tonumber(ARGV[12]) then return redis.status_reply('LOST') end
redis.call('HSET', session, 'commit', ARGV[3])
if ARGV[9] ~= '' then redis.call('HSET', session, 'checkpoint', ARGV[9]) end
if ARGV[10] ~= '' then
  redis.call('HSET', session, 'lifecycle', ARGV[10])
  note_lifecycle_write(ARGV[1])
end
if ARGV[6] ~= '' then redis.call('ZADD', ended, ARGV[6], ARGV[1]) end

local function first_of(entry) return tonumber(string.match(entry[1], '^(%d+)')) end
local function last_of(entry) return tonumber(string.match(entry[1], '(%d+)$')) end
local kept = math.max(tonumber(held[3]), tonumber(ARGV[5]))
if #ARGV > 12 then
  local replaced = redis.call('XRANGE', poses, ARGV[4], '+')
  for _, entry in ipairs(replaced) do redis.call('XDEL', poses, entry[1]) end
  if #replaced > 0 then
    local top = redis.call('XREVRANGE', poses, '+', '-', 'COUNT', 1)
    redis.call('XSETID', poses, top[1] and top[1][1] or '0-0')
  end
  for i = 13, #ARGV, 3 do redis.call('XADD', poses, ARGV[i] .. '-' .. ARGV[i + 1], 'b', ARGV[i + 2]) end
  redis.call('HSET', session, 'next', string.format('%.0f', tonumber(ARGV[#ARGV - 1]) + 1))
  if redis.call('XLEN', poses) > tonumber(ARGV[8]) then
    redis.call('XTRIM', poses, 'MAXLEN', ARGV[8])
    kept = math.max(kept, first_of(redis.call('XRANGE', poses, '-', '+', 'COUNT', 1)[1]))
  end
end
local edge = redis.call('XREVRANGE', poses, string.format('%.0f', kept), '-', 'COUNT', 1)[1]
if edge then
  local oldest = first_of(edge)
  if last_of(edge) < kept then oldest = oldest + 1 end
  redis.call('XTRIM', poses, 'MINID', string.format('%.0f', oldest))
end
redis.call('HSET', session, 'kept', string.format('%.0f', kept))
redis.call('PEXPIRE', session, ARGV[7])
redis.call('PEXPIRE', poses, ARGV[7])
return redis.status_reply('OK')
)lua");

const RedisScript kRedisDelete = SessionScript(kDeleteSession, R"lua(
local held = redis.call('HMGET', session, 'fencing', 'holder')
if ARGV[2] ~= '' and held[1] then
  if tonumber(held[1]) < tonumber(ARGV[2]) then return redis.status_reply('LOST') end
  if held[1] ~= ARGV[2] or held[2] ~= ARGV[3] then return redis.status_reply('FENCED') end
end
delete_session(ARGV[1])
return redis.status_reply('OK')
)lua");

const RedisScript kRedisDeleteEnded = SessionScript(kDeleteSession, R"lua(
local ended_at = redis.call('ZSCORE', ended, ARGV[1])
if not ended_at then return redis.status_reply('KEPT') end
if ARGV[2] ~= '+inf' and tonumber(ended_at) >= tonumber(ARGV[2]) then return redis.status_reply('KEPT') end
delete_session(ARGV[1])
return redis.status_reply('OK')
)lua");

const RedisScript kRedisPutModel = ModelScript(R"lua(
redis.call('HSET', KEYS[2], 'header', ARGV[2], 'bytes', ARGV[3])
redis.call('SADD', KEYS[3], ARGV[1])
return redis.status_reply('OK')
)lua");

const RedisScript kRedisDeleteModel = ModelScript(R"lua(
redis.call('DEL', KEYS[2])
redis.call('SREM', KEYS[3], ARGV[1])
return redis.status_reply('OK')
)lua");

const RedisScript kRedisMakeBucket = {R"lua(
if redis.call('EXISTS', KEYS[1]) == 1 then return 0 end
redis.call('HSET', KEYS[1], 'state', 'here', 'epoch', ARGV[1], 'fencing', 0)
return 1
)lua"};

const RedisScript kRedisBeginMove = {R"lua(
local state, to = unpack(redis.call('HMGET', KEYS[1], 'state', 'to'))
if state ~= 'here' and state ~= 'moving' and state ~= 'leaving' then
  return redis.error_reply('ELSEWHERE ' .. (state or 'unknown'))
end
if state ~= 'leaving' then
  redis.call('HDEL', KEYS[1], 'mover')
  redis.call('HSET', KEYS[1], 'state', 'moving', 'mover', ARGV[2])
  if state == 'here' then redis.call('HSET', KEYS[1], 'to', ARGV[1]) end
end
return redis.call('HMGET', KEYS[1], 'state', 'to', 'epoch', 'fencing')
)lua"};

const RedisScript kRedisRevertMove = {R"lua(
local state, mover = unpack(redis.call('HMGET', KEYS[1], 'state', 'mover'))
if state == 'moving' and mover == ARGV[1] then
  redis.call('HDEL', KEYS[1], 'mover', 'to')
  redis.call('HSET', KEYS[1], 'state', 'here')
end
return redis.status_reply('OK')
)lua"};

const RedisScript kRedisLeave = {R"lua(
local state, mover = unpack(redis.call('HMGET', KEYS[1], 'state', 'mover'))
if state == 'leaving' then return redis.status_reply('OK') end
if state ~= 'moving' or mover ~= ARGV[1] then return redis.status_reply('OTHER') end
redis.call('HDEL', KEYS[1], 'mover')
redis.call('HSET', KEYS[1], 'state', 'leaving')
return redis.status_reply('OK')
)lua"};

const RedisScript kRedisRestore = {R"lua(
local state = redis.call('HGET', KEYS[1], 'state')
if state == 'here' then return redis.status_reply('HERE') end
if state == 'moved' then redis.call('HSET', KEYS[1], 'state', 'arriving') end
return redis.call('RESTORE', KEYS[2], ARGV[1], ARGV[2], 'REPLACE')
)lua"};

const RedisScript kRedisArrive = {R"lua(
local epoch = redis.call('HGET', KEYS[1], 'epoch')
if not epoch or tonumber(epoch) < tonumber(ARGV[1]) then
  redis.call('HSET', KEYS[1], 'state', 'here', 'epoch', ARGV[1], 'fencing', ARGV[2])
  redis.call('HDEL', KEYS[1], 'to', 'mover')
end
return redis.status_reply('OK')
)lua"};

const RedisScript kRedisMoved = {R"lua(
if redis.call('HGET', KEYS[1], 'state') == 'leaving' then
  redis.call('HDEL', KEYS[1], 'mover')
  redis.call('HSET', KEYS[1], 'state', 'moved')
end
return redis.status_reply('OK')
)lua"};

const RedisScript kRedisForget = {R"lua(
if redis.call('HGET', KEYS[1], 'state') ~= 'moved' then return 0 end
return redis.call('UNLINK', KEYS[2])
)lua"};

const RedisScript kRedisJoin = {R"lua(
redis.call('HSETNX', KEYS[1], 'id', ARGV[1])
redis.call('HSETNX', KEYS[1], 'name', ARGV[2])
if ARGV[3] ~= '' then redis.call('HSETNX', KEYS[1], 'groups', ARGV[3]) end
return redis.call('HMGET', KEYS[1], 'id', 'name', 'groups')
)lua"};

const RedisScript kRedisName = {R"lua(
if redis.call('HGET', KEYS[1], 'name') == '' then
  redis.call('HSET', KEYS[1], 'name', ARGV[1], 'groups', ARGV[1])
end
return redis.status_reply('OK')
)lua"};

const std::vector<const RedisScript*>& AllRedisScripts() {
  static const std::vector<const RedisScript*> scripts = {
      &kRedisCreate,      &kRedisRead,       &kRedisCommit, &kRedisDelete, &kRedisDeleteEnded, &kRedisPutModel,
      &kRedisDeleteModel, &kRedisMakeBucket, &kRedisJoin,   &kRedisName,   &kRedisBeginMove,   &kRedisRevertMove,
      &kRedisLeave,       &kRedisRestore,    &kRedisArrive, &kRedisMoved,  &kRedisForget};
  return scripts;
}

}  // namespace evpose::server
