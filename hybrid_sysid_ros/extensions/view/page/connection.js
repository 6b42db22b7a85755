// The connection with the server. The page's token stands behind the # of its address, which a browser sends nobody. It
// is told only to a server that has shown that it knows it, so that no other program that has got the port learns it.

const RETRY = 1000; // ms
const UNKNOWN = "The program on this port is not the view that made this page. Paste the address that the view has printed.";
const MISSING = "Paste the address that the view has printed.";

const hexadecimal = (bytes) => Array.from(new Uint8Array(bytes), (byte) => byte.toString(16).padStart(2, "0")).join("");

// Whether the server knows the token: HMAC-SHA256 of a nonce.
async function proven(token) {
  const nonce = hexadecimal(crypto.getRandomValues(new Uint8Array(16)));
  const answer = await fetch(`proof?nonce=${nonce}`);
  const text = new TextEncoder();
  const key = await crypto.subtle.importKey("raw", text.encode(token), { name: "HMAC", hash: "SHA-256" }, false, ["sign"]);
  return answer.ok && (await answer.text()) === hexadecimal(await crypto.subtle.sign("HMAC", key, text.encode(nonce)));
}

export class Connection {
  // hear: gets each text as an object; take: each frame; lost: is called with a reason where there is no connection, and
  // whether its user has to say where the view is.
  constructor({ hear, take, lost }) {
    Object.assign(this, { hear, take, lost });
    this.socket = null;
    this.asked = 0;
    addEventListener("hashchange", () => this.again());
    this.open();
  }

  get isOpen() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  // The address that a user gives, or the token alone.
  setAddress(text) {
    location.hash = `token=${/token=([\w-]+)/.exec(text)?.[1] ?? text.trim()}`;
  }

  async open() {
    clearTimeout(this.retry);
    const token = new URLSearchParams(location.hash.slice(1)).get("token");
    if (!token) return this.lost(MISSING, true);
    try {
      if (!(await proven(token))) {
        this.lost(UNKNOWN, true);
        return this.later();
      }
    } catch {
      this.lost("", false);
      return this.later();
    }
    const address = new URL(`live?token=${encodeURIComponent(token)}`, location.href);
    address.protocol = "ws:";
    address.hash = "";
    const socket = (this.socket = new WebSocket(address));
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.hear(JSON.parse(data)) : this.take(data));
    socket.onclose = ({ reason }) => {
      if (socket !== this.socket) return;
      this.lost(reason, false);
      this.later();
    };
  }

  later() {
    clearTimeout(this.retry);
    this.retry = setTimeout(() => this.open(), RETRY);
  }

  again() {
    const socket = this.socket;
    this.socket = null;
    socket?.close();
    this.open();
  }

  // Ask for something; whether it was sent.
  ask(request) {
    if (this.isOpen) this.socket.send(JSON.stringify({ id: ++this.asked, ...request }));
    return this.isOpen;
  }

  wantNext() {
    if (this.isOpen) this.socket.send('{"do":"next"}');
  }
}
