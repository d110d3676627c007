// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_scripts.h"

namespace evpose::server {

// When its memory is full, Redis rejects the first write of a script, but no later one. In each script the first write
// is a command that Redis may reject, so that a script is never executed in part.

namespace {

const char* const kNoteLifecycleWrite = R"lua(
local function note_lifecycle_write(writes, name)
  local last = redis.call('ZREVRANGE', writes, 0, 0, 'WITHSCORES')[2] or '0'
  redis.call('ZADD', writes, string.format('%.0f', tonumber(last) + 1), name)
end
)lua";

// Removes a session from owners, tenants, requests and lifecycle_writes.
const char* const kRemoveFromIndexes = R"lua(
local function remove_from_indexes(name, owners, tenants, requests, writes)
  local owner = redis.call('HGET', owners, name)
  if owner then
    redis.call('ZREM', tenants, string.match(owner, '^[^\n]*\n') .. name)
    if redis.call('HGET', requests, owner) == name then redis.call('HDEL', requests, owner) end
    redis.call('HDEL', owners, name)
  end
  redis.call('ZREM', writes, name)
end
)lua";

}  // namespace

const RedisScript kRedisCreate = {std::string(kNoteLifecycleWrite) + R"lua(
if redis.call('EXISTS', KEYS[1]) == 1 then return 0 end
local owner = ARGV[6] .. '\n' .. ARGV[7]
if ARGV[7] ~= '' then
  local of_request = redis.call('HGET', KEYS[6], owner)
  if of_request and redis.call('EXISTS', ARGV[8] .. of_request) == 1 then return 0 end
end
local number = redis.call('INCR', KEYS[3])
redis.call('HSET', KEYS[1], 'fencing', number, 'holder', ARGV[5], 'commit', 0, 'next', 1, 'kept', 1,
  'record', ARGV[2], 'lifecycle', ARGV[3])
redis.call('PEXPIRE', KEYS[1], ARGV[4])
redis.call('SADD', KEYS[2], ARGV[1])
redis.call('HSET', KEYS[4], ARGV[1], owner)
redis.call('ZADD', KEYS[5], 0, ARGV[6] .. '\n' .. ARGV[1])
if ARGV[7] ~= '' then redis.call('HSET', KEYS[6], owner, ARGV[1]) end
note_lifecycle_write(KEYS[7], ARGV[1])
return number
)lua"};

const RedisScript kRedisIndex = {R"lua(
local owner = ARGV[2] .. '\n' .. ARGV[3]
redis.call('HSET', KEYS[1], ARGV[1], owner)
redis.call('ZADD', KEYS[2], 0, ARGV[2] .. '\n' .. ARGV[1])
if ARGV[3] ~= '' then redis.call('HSETNX', KEYS[3], owner, ARGV[1]) end
redis.call('ZADD', KEYS[4], 'NX', 0, ARGV[1])
return redis.status_reply('OK')
)lua"};

const RedisScript kRedisRead = {R"lua(
if redis.call('EXISTS', KEYS[1]) == 0 then return false end
if ARGV[1] == '1' then
  redis.call('HSET', KEYS[1], 'fencing', redis.call('INCR', KEYS[3]), 'holder', ARGV[5], 'commit', 0)
  redis.call('PEXPIRE', KEYS[1], ARGV[2])
  redis.call('PEXPIRE', KEYS[2], ARGV[2])
end
local values = redis.call('HMGET', KEYS[1], 'fencing', 'next', 'kept', 'record', 'lifecycle', 'checkpoint')
local begin = ARGV[4]
local across = redis.call('XREVRANGE', KEYS[2], ARGV[3], '-', 'COUNT', 1)[1]
if across and tonumber(string.match(across[1], '(%d+)$')) > tonumber(ARGV[3]) then begin = across[1] end
values[7] = redis.call('XRANGE', KEYS[2], begin, '+')
return values
)lua"};

const RedisScript kRedisCommit = {std::string(kNoteLifecycleWrite) + R"lua(
local held = redis.call('HMGET', KEYS[1], 'fencing', 'commit', 'kept', 'holder')
if not held[1] then return redis.status_reply('NOTFOUND') end
if tonumber(held[1]) < tonumber(ARGV[2]) then return redis.status_reply('LOST') end
if held[1] ~= ARGV[2] or held[4] ~= ARGV[11] then return redis.status_reply('FENCED') end
if tonumber(held[2]) >= tonumber(ARGV[3]) then return redis.status_reply('STALE') end
if tonumber(held[2]) < tonumber(ARGV[12]) then return redis.status_reply('LOST') end
redis.call('HSET', KEYS[1], 'commit', ARGV[3])
if ARGV[9] ~= '' then redis.call('HSET', KEYS[1], 'checkpoint', ARGV[9]) end
if ARGV[10] ~= '' then
  redis.call('HSET', KEYS[1], 'lifecycle', ARGV[10])
  note_lifecycle_write(KEYS[4], ARGV[1])
end
if ARGV[6] ~= '' then redis.call('ZADD', KEYS[3], ARGV[6], ARGV[1]) end

local function first_of(entry) return tonumber(string.match(entry[1], '^(%d+)')) end
local function last_of(entry) return tonumber(string.match(entry[1], '(%d+)$')) end
local kept = math.max(tonumber(held[3]), tonumber(ARGV[5]))
if #ARGV > 12 then
  local replaced = redis.call('XRANGE', KEYS[2], ARGV[4], '+')
  for _, entry in ipairs(replaced) do redis.call('XDEL', KEYS[2], entry[1]) end
  if #replaced > 0 then
    local top = redis.call('XREVRANGE', KEYS[2], '+', '-', 'COUNT', 1)
    redis.call('XSETID', KEYS[2], top[1] and top[1][1] or '0-0')
  end
  for i = 13, #ARGV, 3 do redis.call('XADD', KEYS[2], ARGV[i] .. '-' .. ARGV[i + 1], 'b', ARGV[i + 2]) end
  redis.call('HSET', KEYS[1], 'next', string.format('%.0f', tonumber(ARGV[#ARGV - 1]) + 1))
  if redis.call('XLEN', KEYS[2]) > tonumber(ARGV[8]) then
    redis.call('XTRIM', KEYS[2], 'MAXLEN', ARGV[8])
    kept = math.max(kept, first_of(redis.call('XRANGE', KEYS[2], '-', '+', 'COUNT', 1)[1]))
  end
end
local edge = redis.call('XREVRANGE', KEYS[2], string.format('%.0f', kept), '-', 'COUNT', 1)[1]
if edge then
  local oldest = first_of(edge)
  if last_of(edge) < kept then oldest = oldest + 1 end
  redis.call('XTRIM', KEYS[2], 'MINID', string.format('%.0f', oldest))
end
redis.call('HSET', KEYS[1], 'kept', string.format('%.0f', kept))
redis.call('PEXPIRE', KEYS[1], ARGV[7])
redis.call('PEXPIRE', KEYS[2], ARGV[7])
return redis.status_reply('OK')
)lua"};

const RedisScript kRedisDelete = {std::string(kRemoveFromIndexes) + R"lua(
local held = redis.call('HMGET', KEYS[1], 'fencing', 'holder')
if ARGV[2] ~= '' and held[1] then
  if tonumber(held[1]) < tonumber(ARGV[2]) then return redis.status_reply('LOST') end
  if held[1] ~= ARGV[2] or held[2] ~= ARGV[3] then return redis.status_reply('FENCED') end
end
redis.call('DEL', KEYS[1], KEYS[2])
redis.call('ZREM', KEYS[3], ARGV[1])
redis.call('SREM', KEYS[4], ARGV[1])
remove_from_indexes(ARGV[1], KEYS[5], KEYS[6], KEYS[7], KEYS[8])
return redis.status_reply('OK')
)lua"};

const RedisScript kRedisDeleteEnded = {std::string(kRemoveFromIndexes) + R"lua(
local limit = ARGV[1] == '+inf' and '+inf' or '(' .. ARGV[1]
local names = redis.call('ZRANGEBYSCORE', KEYS[1], '-inf', limit, 'LIMIT', 0, ARGV[2])
for _, name in ipairs(names) do
  redis.call('DEL', ARGV[3] .. name, ARGV[4] .. name)
  redis.call('ZREM', KEYS[1], name)
  redis.call('SREM', KEYS[2], name)
  remove_from_indexes(name, KEYS[3], KEYS[4], KEYS[5], KEYS[6])
end
return names
)lua"};

const RedisScript kRedisPutModel = {R"lua(
redis.call('HSET', KEYS[1], 'header', ARGV[2], 'bytes', ARGV[3])
redis.call('SADD', KEYS[2], ARGV[1])
return 1
)lua"};

const RedisScript kRedisDeleteModel = {R"lua(
redis.call('DEL', KEYS[1])
return redis.call('SREM', KEYS[2], ARGV[1])
)lua"};

}  // namespace evpose::server
