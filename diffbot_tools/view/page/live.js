// The connection to `diffbot watch`: receives states and events, sends goals and other requests.

const RETRY = 1500; // [ms] from the loss of the connection to the next attempt

export class Live {
  constructor({ onHello, onHistory, onState, onEvents, onAnswer, onConnected }) {
    this.handlers = { hello: onHello, history: onHistory, state: onState, events: onEvents, answer: onAnswer };
    this.onConnected = onConnected;
    this.connect();
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(`${scheme}//${location.host}/ws${location.search}`);
    this.socket.addEventListener("open", () => this.onConnected(true));
    this.socket.addEventListener("message", (event) => {
      const message = JSON.parse(event.data);
      this.handlers[message.type]?.(message);
    });
    this.socket.addEventListener("close", () => {
      this.onConnected(false);
      setTimeout(() => this.connect(), RETRY);
    });
  }

  /** Send a request; false without a connection. */
  send(request) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(request));
    return true;
  }
}
