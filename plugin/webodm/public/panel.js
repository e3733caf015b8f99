/* The panel in WebODM's New Task form: checks the files as they are chosen, and creates the right tasks on a click. */
(function (sensorgate) {
  "use strict";

  var h = sensorgate.dom.h, count = sensorgate.dom.count, plural = sensorgate.dom.plural, views = sensorgate.views;
  var DRAW_PAUSE_MS = 200;

  function openPanel(element, props) {
    var item = element.closest(".project-list-item");
    var mark = (item || element.closest("li, section, body")).querySelector("[data-sensorgate-project]");
    var project = mark ? Number(mark.getAttribute("data-sensorgate-project")) : null;
    var check = null, timer = null, started = false, hidden = false, trouble = "";
    var act = { busy: true, open: {}, move: move, rule: rule };

    var status = h("p.sg-status", { role: "status" });
    var bar = h("div.sg-bar", { "aria-hidden": "true" }, h("div", null));
    var body = h("div.sg-body", null);
    sensorgate.dom.fill(element, h("section.sg-panel", { "aria-label": "Camera check" },
      h("header", null, h("h4", null, "Camera check"), status), bar, body));

    function update(next) {
      props = next;
      if (project === null) {
        status.textContent = "The camera check does not know which project this is. Reload the page.";
        return;
      }
      if (!check) check = new sensorgate.Check(project, draw);
      // All of them: the form itself only hands on those that were chosen last.
      check.add(item && item.dropzone ? item.dropzone.files.filter(isWaiting) : []);
      check.add(props.getFiles ? props.getFiles() : []);
      draw();
    }

    function draw() {
      if (!timer) timer = setTimeout(function () { timer = null; drawNow(); }, DRAW_PAUSE_MS);
    }

    function drawNow() {
      if (!check || started) return;
      var words = statusWords(check);
      if (status.textContent !== words) status.textContent = words;
      var working = check.phase !== "ready" && check.phase !== "failed";
      bar.hidden = !working;
      bar.firstChild.style.width = (check.images ? Math.round(100 * check.done / check.images) : 0) + "%";
      act.busy = !check.verdictWhole;
      body.setAttribute("aria-busy", String(working));
      sensorgate.dom.redraw(body, hidden ? shortened() : content());
    }

    function content() {
      var verdict = check.verdict;
      if (check.phase === "failed") {
        return h("div.sg-failed", null, h("p", null, check.message),
          h("p", null, "You can upload as always; the check is not needed for that."),
          button("Check again", "btn-default", function () { check.restart(); }));
      }
      if (!verdict) return [views.cameras(check.cameras), views.leftOut(check.unread, act)];
      // The buttons stay in view beside the details; they shall not lie over the headline.
      return [views.headline(verdict, act.busy), h("div", null, act.busy ? soFar(verdict) : details(verdict), buttons(verdict))];
    }

    function soFar(verdict) {
      return [views.comparison(verdict), views.cameras(verdict.cameras), views.leftOut(check.unread, act)];
    }

    function details(verdict) {
      var left = verdict.left_out.concat(check.unread.filter(function (each) {
        return !verdict.left_out.some(function (told) { return told.id === each.id; });
      }));
      return [
        views.comparison(verdict),
        views.findings(verdict, act),
        views.leftOut(left, act),
        views.cameras(verdict.cameras),
        views.tasks(verdict, act, baseName()),
        views.rules(verdict, act),
        verdict.tasks.length ? views.others(sensorgate.others.place(check.others, check.files, verdict).told) : null,
        notes(verdict)
      ];
    }

    function shortened() {
      return [
        check.verdict ? views.headline(check.verdict, act.busy) : null,
        h("div.sg-buttons", null, button("Show the suggestion", "btn-default", function () { hidden = false; drawNow(); }))
      ];
    }

    function notes(verdict) {
      var told = [check.hold === "hold" ? heldWords(verdict, check) : "", trouble];
      return told.filter(Boolean).map(function (text) { return h("p.sg-note", null, text); });
    }

    function buttons(verdict) {
      var ready = check.phase === "ready" && check.verdictFinal && verdict.tasks.length > 0;
      var chosen = check.choices.off.length || Object.keys(check.choices.moves).length;
      var size = ready ? " " + sensorgate.dom.bytes(sizeOf(withOthers(check), check.files)) : "";
      var label = (verdict.tasks.length === 1 ? "Create the task" : "Create " + plural(verdict.tasks.length, "task")) + " and upload" + size;
      return h("div.sg-buttons.sg-act.theme-background-highlight", null,
        verdict.tasks.length ? button(act.busy ? "Still reading…" : label, "btn-primary", start, !ready, "create") : null,
        button("Go on as before", "btn-default", asBefore, false, "before"),
        chosen ? button("Back to the suggestion", "btn-default", function () { choose({ off: [], moves: {} }); }, act.busy, "reset") : null,
        verdict.report && ready ? h("a", { href: verdict.report, target: "_blank", rel: "noopener" }, "Full report") : null);
    }

    function button(label, look, click, disabled, key) {
      return h("button.btn.btn-sm." + look, { type: "button", onclick: click, disabled: Boolean(disabled), "data-key": key || label }, label);
    }

    /* Drawn at once: nothing can be created from a verdict that the choice has made old. */
    function choose(choices) {
      check.choose(choices);
      drawNow();
    }

    function rule(id, on) {
      var off = check.choices.off.filter(function (each) { return each !== id; });
      choose({ off: on ? off : off.concat([id]), moves: check.choices.moves });
    }

    function move(payload, task) {
      var moves = {};
      Object.keys(check.choices.moves).forEach(function (id) { moves[id] = check.choices.moves[id]; });
      moves[payload] = task;
      choose({ off: check.choices.off, moves: moves });
    }

    function asBefore() {
      hidden = true;
      drawNow();
      var form = element.closest(".new-task-panel");
      var buttons = form ? form.querySelectorAll("button.btn-primary[type=submit]") : [];
      if (buttons.length) buttons[buttons.length - 1].focus();
    }

    function nameField() {
      var form = element.closest(".new-task-panel");
      return form ? form.querySelector(".edit-task-form input[type=text]") : null;
    }

    /* The form tells of a new name, but not of new tags or a drawn boundary: a name that is typed and taken back
       makes it tell all. */
    function refreshInfo() {
      var field = nameField();
      if (!field) return;
      var write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set, value = field.value;
      [value + " ", value].forEach(function (text) {
        write.call(field, text);
        field.dispatchEvent(new Event("input", { bubbles: true }));
      });
    }

    function baseName() {
      var field = nameField();
      return (field && (field.value || field.placeholder)) || (props.taskInfo || {}).name || "Task";
    }

    function start() {
      if (started || check.phase !== "ready" || !check.verdictFinal) return;
      try {
        refreshInfo();
        var order = {
          project: project, session: check.session, name: baseName(), info: props.taskInfo || {}, choices: check.choices,
          tasks: withOthers(check).map(function (task) { return ordered(task, check.files); })
        };
        started = true;
        sensorgate.dock.take(new sensorgate.Upload(order), item);
      } catch (error) {
        started = false;
        trouble = error.message;
        return drawNow();
      }
      leaveForm(item, project);
    }

    function close() {
      clearTimeout(timer);
      if (check) check.close();
    }

    update(props);
    return { update: update, close: close };
  }

  /* Files of an upload before this one may still be in the form's list. */
  function isWaiting(file) {
    return ["success", "canceled", "error"].indexOf(file.status) < 0;
  }

  /* The verdict's tasks with the files that go along with them. */
  function withOthers(check) {
    var along = sensorgate.others.place(check.others, check.files, check.verdict).along;
    return check.verdict.tasks.map(function (task) {
      return Object.assign({}, task, { files: task.files.concat(along[task.key]) });
    });
  }

  function sizeOf(tasks, files) {
    return tasks.reduce(function (sum, task) {
      return task.files.reduce(function (part, entry) { return part + (files[entry[0]] ? files[entry[0]].size : 0); }, sum);
    }, 0);
  }

  /* A task of the verdict with its real files; refuses names that would overwrite each other. */
  function ordered(task, files) {
    var taken = {};
    Object.keys(task.texts || {}).forEach(function (name) { taken[name.toLowerCase()] = true; });
    var parts = task.files.map(function (entry) {
      var file = files[entry[0]], name = entry[1];
      if (!file || !name || /[\\/]/.test(name) || taken[name.toLowerCase()]) {
        throw new Error("The suggested tasks do not fit the chosen files. Choose the files again.");
      }
      taken[name.toLowerCase()] = true;
      return [file, name];
    });
    return { key: task.key, name: task.name, options: task.options, tags: task.tags, texts: task.texts, files: parts };
  }

  /* Close the form as its own Cancel does, so that none of its files is sent a second time. */
  function leaveForm(item, project) {
    if (item && item.dropzone) item.dropzone.removeAllFiles(true);
    if (sensorgate.taskAdded[project]) sensorgate.taskAdded[project]();
    // The form was long: without it the page stands somewhere else.
    if (item) requestAnimationFrame(function () { item.scrollIntoView({ block: "nearest" }); });
  }

  /* What hold mode will do with these files on the server. */
  function heldWords(verdict, check) {
    var mixes = check.choices.off.indexOf("split") >= 0
      || Object.keys(check.choices.moves).some(function (payload) { return check.choices.moves[payload]; });
    if (mixes && !check.mayOverride) {
      return "This server checks every task after its upload: frames that do not belong together are taken apart again there.";
    }
    if (!verdict.tasks.length) return "This server checks every task after its upload: these files would be held there.";
    if (verdict.tasks.length === 1) return "";
    return "This server checks every task after its upload: sent as one, these files would be taken apart there.";
  }

  function statusWords(check) {
    if (check.message && check.phase !== "failed") return check.message;
    if (check.phase === "failed") return "The camera check stopped.";
    if (!check.images) return "No images are chosen yet.";
    var share = check.imageBytes ? 100 * check.sentBytes / check.imageBytes : 0;
    var few = share < 0.1 ? "less than 0.1" : share.toFixed(1);
    if (check.phase === "ready") return plural(check.images, "image") + " checked. No picture was uploaded for this (" + few + " % read out as metadata).";
    if (check.phase === "judging") return plural(check.images, "image") + " read. Judging…";
    return "Reading the metadata of " + count(check.done) + " of " + plural(check.images, "image") + ". No picture is uploaded for this.";
  }

  sensorgate.openPanel = openPanel;
})(window.sensorgate);
