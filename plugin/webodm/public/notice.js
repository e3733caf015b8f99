/* Under a project's name: which of its tasks wait for the camera check, why, and how far it is. WebODM's own rows do
   not follow a task that has no node yet; when one goes on, the project's list is read anew. */
(function (sensorgate) {
  "use strict";

  var h = sensorgate.dom.h, plural = sensorgate.dom.plural;
  var SETTLE_MS = 1000;
  var POLL_MS = 5000;
  var MOST_SHOWN = 5;
  // What somebody has to see to; everything else goes on by itself.
  var HELD = "held", BROKEN_OFF = "broken-off", WORKING = "working";
  var watched = {};
  var timer = null, lastAsked = -POLL_MS;

  /* Watch a project from a place in its list item. */
  function openNotice(element, props) {
    var project = props.projectId;
    var item = element.closest(".project-list-item");
    var place = h("section.sg-notice", { "aria-label": "Tasks that wait for the camera check" });
    if (!item) return { update: soon, close: function () {} };
    item.insertBefore(place, item.querySelector(":scope > .drag-drop-icon"));
    watched[project] = { item: item, place: place, tasks: [] };
    soon();
    return {
      update: soon,
      close: function () {
        place.remove();
        if (watched[project] && watched[project].place === place) delete watched[project];
      }
    };
  }

  function soon() {
    if (timer) return;
    timer = setTimeout(ask, Math.max(SETTLE_MS, lastAsked + POLL_MS - performance.now()));
  }

  /* One question for all projects of the page. */
  function ask() {
    timer = null;
    var projects = Object.keys(watched);
    if (!projects.length || document.hidden) return;
    lastAsked = performance.now();
    sensorgate.requests.send("GET", sensorgate.api + "waiting?projects=" + projects.join(",")).then(function (answer) {
      projects.forEach(function (project) {
        if (watched[project]) told(project, answer.projects[project] || []);
      });
    }, function () {
      // What is shown stays; whoever was logged out or lost the line sees that elsewhere.
    }).then(function () {
      if (projects.some(function (project) { return watched[project] && watched[project].tasks.length; })) soon();
    });
  }

  function told(project, tasks) {
    var entry = watched[project], before = entry.tasks;
    entry.tasks = tasks.filter(function (task) { return !(sensorgate.dock && sensorgate.dock.fills(task.id)); });
    draw(project, entry);
    var changed = before.some(function (old) {
      return !entry.tasks.some(function (now) { return now.id === old.id && rank(now) === rank(old); });
    });
    if (changed) sensorgate.refresh(project, entry.item);
  }

  function rank(task) {
    return task.state === HELD ? 0 : task.state === BROKEN_OFF ? 1 : 2;
  }

  function draw(project, entry) {
    var sorted = entry.tasks.slice().sort(function (a, b) { return rank(a) - rank(b); });
    sensorgate.dom.redraw(entry.place, sorted.length ? [
      h("h5", { role: "status" }, title(sorted)),
      h("ul", null, sorted.slice(0, MOST_SHOWN).map(function (task) { return row(project, task); })),
      sorted.length > MOST_SHOWN ? h("p", null, "And " + (sorted.length - MOST_SHOWN) + " more.") : null
    ] : null);
  }

  function title(tasks) {
    function many(state) { return tasks.filter(function (task) { return task.state === state; }).length; }
    var held = many(HELD), broken = many(BROKEN_OFF), worked = many(WORKING);
    var under = tasks.length - held - broken - worked;
    return [
      held ? plural(held, "task") + (held === 1 ? " is held and needs" : " are held and need") + " your decision" : "",
      broken ? plural(broken, "upload") + (broken === 1 ? " was" : " were") + " broken off" : "",
      worked ? plural(worked, "task") + (worked === 1 ? " is" : " are") + " being prepared on this server" : "",
      under ? plural(under, "task") + (under === 1 ? " waits" : " wait") + " for the camera check" : ""
    ].filter(Boolean).join("; ");
  }

  function row(project, task) {
    var address = "/dashboard/?project_task_open=" + project + "&project_task_expanded=" + task.id;
    return h("li.sg-notice-" + task.state, null,
      h("a", { href: address, "data-key": "notice-" + task.id }, task.name || "Unnamed task"), " ", task.message,
      typeof task.progress === "number" ? sensorgate.dom.bar(task.progress, "How far " + (task.name || "the task") + " is") : null);
  }

  document.addEventListener("visibilitychange", function () { if (!document.hidden) soon(); });

  sensorgate.openNotice = openNotice;
})(window.sensorgate);
