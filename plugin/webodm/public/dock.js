/* The uploads under way, at the foot of the page: they go on while the user does something else in the dashboard. */
(function (sensorgate) {
  "use strict";

  var h = sensorgate.dom.h, plural = sensorgate.dom.plural, bytes = sensorgate.dom.bytes;
  var DRAW_PAUSE_MS = 250;
  var STATES = {
    waiting: "Waits its turn", creating: "Creating the task…", uploading: "", starting: "Starting…", done: "Uploaded and started",
    failed: "Stopped", cancelled: "Cancelled"
  };
  var uploads = [];
  var root = null;

  function guard(event) {
    event.preventDefault();
    event.returnValue = "Files are still being uploaded.";
    return event.returnValue;
  }

  function watchLeaving() {
    window.removeEventListener("beforeunload", guard);
    if (uploads.some(function (each) { return each.upload.running; })) window.addEventListener("beforeunload", guard);
  }

  /* Run an upload and show it; its project's list item is refreshed when a task was started. */
  function take(upload, item) {
    if (!root) {
      root = h("div.sg-dock", { role: "region", "aria-label": "Uploads of the camera check" });
      document.body.appendChild(root);
    }
    var place = h("section.sg-upload", { tabindex: "-1" });
    var entry = { upload: upload, place: place, timer: null, told: 0 };
    uploads.push(entry);
    root.appendChild(place);
    upload.listeners.push(function () {
      if (upload.started().length > entry.told) {
        entry.told = upload.started().length;
        sensorgate.refresh(upload.order.project, item);
      }
      if (!entry.timer) entry.timer = setTimeout(function () { entry.timer = null; draw(entry); }, DRAW_PAUSE_MS);
    });
    run(entry);
    place.focus({ preventScroll: true });
  }

  function run(entry) {
    var finished = entry.upload.run();
    watchLeaving();
    draw(entry);
    finished.then(function () { watchLeaving(); draw(entry); });
  }

  function draw(entry) {
    var upload = entry.upload, rows = upload.rows;
    var failed = rows.some(function (row) { return row.state === "failed"; });
    var total = rows.reduce(function (sum, row) { return sum + row.total; }, 0);
    var sent = rows.reduce(function (sum, row) { return sum + upload.sentBytes(row); }, 0);
    var share = total ? Math.floor(100 * sent / total) : 0;
    sensorgate.dom.redraw(entry.place, [
      h("header", null, h("strong", { role: "status" }, headline(upload, failed, share)), upload.running ? h("small", null, bytes(total - sent) + " to go") : null),
      rows.length > 1 ? h("small", null, upload.order.name) : null,
      h("ul", null, rows.map(function (row) { return drawRow(upload, row); })),
      h("div.sg-buttons", null,
        failed && !upload.running && !upload.cancelled ? button("Try again", "btn-primary", function () { run(entry); }) : null,
        upload.running || (failed && !upload.cancelled) ? button("Cancel upload", "btn-danger", function () { cancel(entry); }) : null,
        !upload.running && (upload.done() || upload.cancelled) ? button("Close", "btn-default", function () { close(entry); }) : null)
    ]);
  }

  function headline(upload, failed, share) {
    if (upload.cancelled) return "Upload cancelled";
    if (upload.running) return "Uploading " + plural(upload.rows.length, "task") + ": " + share + " %";
    if (failed) return "The upload stopped. What is up stays up.";
    return upload.rows.length === 1 ? "The task is started" : "All " + upload.rows.length + " tasks are started";
  }

  function drawRow(upload, row) {
    var share = row.state === "done" ? 1 : row.total ? upload.sentBytes(row) / row.total : 0;
    var words = row.message || STATES[row.state] || row.count + " of " + plural(row.parts.length, "file");
    return h("li.sg-row-" + row.state, null,
      h("span.sg-label", { title: row.name }, upload.rows.length > 1 ? row.task.name : row.name), h("small", null, words),
      row.note ? h("small.sg-row-note", null, row.note) : null,
      sensorgate.dom.bar(share, row.name));
  }

  function cancel(entry) {
    var kept = entry.upload.started().length;
    var question = kept ? "Stop the upload? " + plural(kept, "task") + " already started and will go on."
      : "Stop the upload? What was uploaded so far is deleted.";
    if (!window.confirm(question)) return;
    entry.upload.cancel();
    watchLeaving();
    draw(entry);
  }

  function close(entry) {
    uploads = uploads.filter(function (each) { return each !== entry; });
    root.removeChild(entry.place);
  }

  function button(label, look, click) {
    return h("button.btn.btn-sm." + look, { type: "button", onclick: click, "data-key": label }, label);
  }

  /* Whether this page is filling the task. */
  function fills(task) {
    return uploads.some(function (entry) {
      return entry.upload.running && entry.upload.rows.some(function (row) { return row.id === task; });
    });
  }

  sensorgate.dock = { take: take, fills: fills };
})(window.sensorgate);
