// SPDX-License-Identifier: Apache-2.0
// The WebSocket to the gateway: sends the key, tries again after a lost connection.
import { decodeBinary, type EventImage, type Geometry, type Request, type TextMessage } from "./protocol";

export type Status = "connecting" | "connected" | "retrying" | "full" | "refused" | "no-key";

export interface Receiver {
  /** `reason` is that of the gateway, or empty. */
  onStatus(status: Status, reason: string): void;
  onMessage(message: TextMessage): void;
  onImage(image: EventImage): void;
  onGeometry(geometry: Geometry): void;
  onError(text: string): void;
}

/** The close codes of the gateway for a wrong key or message, and for a page when too many are open. */
const POLICY_VIOLATION = 1008;
const TRY_AGAIN_LATER = 1013;
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
      this.receiver.onStatus("no-key", "");
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
      if (event.code === POLICY_VIOLATION) this.receiver.onStatus("refused", event.reason);
      else this.retry(event.code === TRY_AGAIN_LATER ? "full" : "retrying", event.reason);
    });
  }

  /** Sends a request if the connection is open; requests are not kept for a later connection. */
  send(request: Request): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(request));
  }

  private retry(status: Status, reason: string): void {
    this.receiver.onStatus(status, reason);
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
          this.receiver.onStatus("connected", "");
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
