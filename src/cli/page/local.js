// Answers without a server: a worker has the queries. One question is asked at a time, others wait.

/** A function that asks as `fetch` does, of the archives of these names beside the page. */
export function connect(names) {
  const worker = new Worker(new URL("worker.js", import.meta.url));
  worker.postMessage({ names });
  const waiting = [];
  let running = null;

  const next = () => {
    if (running || waiting.length === 0) return;
    running = waiting.shift();
    worker.postMessage({ address: running.address });
  };
  worker.onmessage = ({ data }) => {
    if (data.piece) {
      running.piece(new Uint8Array(data.piece));
      return;
    }
    running.end(data.status, data.text);
    running = null;
    next();
  };
  worker.onerror = (event) => {
    for (const job of [running, ...waiting.splice(0)]) job?.end(500, event.message ?? "the worker did not start");
    running = null;
  };

  return (address, { signal } = {}) =>
    new Promise((done, failed) => {
      let [stream, gone, begun] = [null, false, false];
      const body = new ReadableStream({ start: (controller) => (stream = controller) });
      const begin = () => {
        if (!begun) done(new Response(body));
        begun = true;
      };
      const job = {
        address,
        piece(bytes) {
          if (gone) return;
          stream.enqueue(bytes);
          begin();
        },
        end(status, text) {
          if (gone) return;
          if (status === 200) {
            begin();
            stream.close();
          } else if (begun) {
            stream.error(new Error(text));
          } else {
            done(new Response(text, { status }));
          }
        },
      };
      signal?.addEventListener("abort", () => {
        gone = true;
        if (waiting.includes(job)) waiting.splice(waiting.indexOf(job), 1);
        // The next one is asked when the worker says that this one has ended.
        if (running === job) worker.postMessage({ stop: true });
        if (begun) stream.error(signal.reason);
        failed(signal.reason);
      });
      waiting.push(job);
      next();
    });
}
