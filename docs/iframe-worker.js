// Browsers start no worker from a file on the disk. There the search runs in a hidden frame instead, which has the same
// messages. The npm package of this name does this too, but mkdocs would load it from a server.
if (location.protocol === "file:")
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc = `<script>postMessage = data => frameElement.answer(data)</script><script src="${url}"></script>`;
      frame.answer = data => this.dispatchEvent(new MessageEvent("message", {data}));
      this.loaded = new Promise(loaded => frame.addEventListener("load", loaded));
      this.frame = frame;
      document.body.append(frame);
    }
    postMessage(data) {
      this.loaded.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", {data})));
    }
    terminate() {
      this.frame.remove();
    }
  };
