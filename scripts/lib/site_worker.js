// Runs the worker of the search in a frame where a page is opened from a folder: browsers start no workers from files.
// The theme looks for the name IFrameWorker.
if (location.protocol === "file:") {
  window.IFrameWorker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.appendChild(frame)
      const inner = frame.contentWindow
      this.loaded = new Promise(resolve => frame.addEventListener("load", resolve))
      inner.postToPage = data => this.dispatchEvent(new MessageEvent("message", { data }))
      inner.document.open()
      inner.document.write(`<script>
        postMessage = postToPage
        importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((resolve, reject) => {
          const script = document.body.appendChild(document.createElement("script"))
          Object.assign(script, { src: url, onload: resolve, onerror: reject })
        })), Promise.resolve())
      </script><script src="${url}"></script>`)
      inner.document.close()
      this.inner = inner
    }
    postMessage(data) {
      this.loaded.then(() => this.inner.dispatchEvent(new MessageEvent("message", { data })))
    }
    terminate() {
      this.inner.frameElement.remove()
    }
  }
  window.Worker = window.IFrameWorker
}
