// SPDX-License-Identifier: Apache-2.0
// The WebSocket to the gateway: sends the key, tries again after a lost connection.
import { decodeBinary, type EventImage, type Geometry, type Request, type TextMessage } from "./protocol";

export type Status = "connecting" | "connected" | "retrying" | "refused" | "no-key";

export interface Receiver {
  onStatus(status: Status): void;
  onMessage(message: TextMessage): void;
  onImage(image: EventImage): void;
  onGeometry(geometry: Geometry): void;
  onError(text: string): void;
}

/** The close code with which the gateway refuses a key. */
const POLICY_VIOLATION = 1008;
const FIRST_RETRY_MS = 300;
const MAX_RETRY_MS = 5000;

export class Connection {
  private socket: WebSocket | null = null;
  private retryMs = FIRST_RETRY_MS;

  constructor(
    private readonly key: string,
    private readonly receiver: Receiver,
  ) {}

  open(): void {
    if (this.key === "") {
      this.receiver.onStatus("no-key");
      return;
    }
    const address = new URL("stream", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.hash = "";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.addEventListener("open", () => {
      this.send({ type: "key", key: this.key });
    });
    socket.addEventListener("message", (event: MessageEvent<string | ArrayBuffer>) => {
      this.receive(event.data);
    });
    socket.addEventListener("close", (event) => {
      this.socket = null;
      if (event.code === POLICY_VIOLATION) this.receiver.onStatus("refused");
      else this.retry();
    });
  }

  /** Sends a request if the connection is open; requests are not kept for a later connection. */
  send(request: Request): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(request));
  }

  private retry(): void {
    this.receiver.onStatus("retrying");
    setTimeout(() => {
      this.open();
    }, this.retryMs);
    this.retryMs = Math.min(2 * this.retryMs, MAX_RETRY_MS);
  }

  private receive(data: string | ArrayBuffer): void {
    try {
      if (typeof data === "string") {
        const message = JSON.parse(data) as TextMessage;
        if (message.type === "hello") {
          this.retryMs = FIRST_RETRY_MS;
          this.receiver.onStatus("connected");
        }
        this.receiver.onMessage(message);
        return;
      }
      const message = decodeBinary(data);
      if (message?.type === "image") this.receiver.onImage(message);
      else if (message?.type === "geometry") this.receiver.onGeometry(message);
    } catch (error) {
      this.receiver.onError(error instanceof Error ? error.message : String(error));
    }
  }
}
