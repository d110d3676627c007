// SPDX-License-Identifier: Apache-2.0
// The server's side of WebSockets (RFC 6455), as far as the fake gateway needs it: messages in one frame, below 16 MB.
import { createHash } from "node:crypto";

const MAX_MESSAGE_BYTES = 1 << 24;

export class WebSocketPeer {
  #socket;
  #received = Buffer.alloc(0);
  onMessage = () => {};
  onClose = () => {};

  constructor(request, socket) {
    this.#socket = socket;
    const accept = createHash("sha1").update(`${request.headers["sec-websocket-key"]}258EAFA5-E914-47DA-95CA-C5AB0DC85B11`).digest("base64");
    socket.setNoDelay(true);
    socket.write(`HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: ${accept}\r\n\r\n`);
    socket.on("data", (data) => this.#receive(data));
    socket.on("error", () => socket.destroy());
    socket.on("close", () => this.onClose());
  }

  sendText(message) {
    this.#send(1, Buffer.from(JSON.stringify(message)));
  }

  sendBinary(data) {
    this.#send(2, data);
  }

  close(code) {
    const body = Buffer.alloc(2);
    body.writeUInt16BE(code);
    this.#send(8, body);
    this.#socket.end();
  }

  /** Ends the connection without a closing frame, as a process that is killed does. */
  destroy() {
    this.#socket.destroy();
  }

  #send(opcode, payload) {
    if (this.#socket.destroyed) return;
    let head;
    if (payload.length < 126) {
      head = Buffer.from([0x80 | opcode, payload.length]);
    } else if (payload.length < 65536) {
      head = Buffer.from([0x80 | opcode, 126, 0, 0]);
      head.writeUInt16BE(payload.length, 2);
    } else {
      head = Buffer.from([0x80 | opcode, 127, 0, 0, 0, 0, 0, 0, 0, 0]);
      head.writeBigUInt64BE(BigInt(payload.length), 2);
    }
    this.#socket.write(Buffer.concat([head, payload]));
  }

  #receive(data) {
    this.#received = Buffer.concat([this.#received, data]);
    for (;;) {
      const frame = this.#received;
      if (frame.length < 2) return;
      let length = frame[1] & 0x7f;
      let offset = 2;
      if (length >= 126) {
        const bytes = length === 126 ? 2 : 8;
        if (frame.length < offset + bytes) return;
        length = bytes === 2 ? frame.readUInt16BE(2) : Number(frame.readBigUInt64BE(2));
        offset += bytes;
      }
      if (length > MAX_MESSAGE_BYTES) return this.destroy();
      if (frame.length < offset + 4 + length) return;
      const mask = frame.subarray(offset, offset + 4);
      const payload = Buffer.from(frame.subarray(offset + 4, offset + 4 + length));
      for (let i = 0; i < length; ++i) payload[i] ^= mask[i & 3];
      this.#received = frame.subarray(offset + 4 + length);
      this.#handle(frame[0] & 15, payload);
    }
  }

  #handle(opcode, payload) {
    if (opcode === 1) this.onMessage(JSON.parse(payload.toString()));
    else if (opcode === 8) this.#socket.end();
    else if (opcode === 9) this.#send(10, payload);
  }
}
