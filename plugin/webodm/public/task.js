/* A task's row in the dashboard: why it waits, what to do, and what its user may do now. */
(function (sensorgate) {
  "use strict";

  var h = sensorgate.dom.h, plural = sensorgate.dom.plural;
  var POLL_MS = 4000;
  var FAILED_STATUS = 30;
  var UNDER_WAY = ["waiting", "checking", "working"];
  var INCOMPLETE = "Not all of its files are here yet. If its upload was broken off, delete this task and choose the files again.";
  var CONFIRM = {
    override: "Let this task go as it is, cameras mixed? It may fail, or come out bent without a warning.",
    prepare: "Harmonize and align the images on this server, then create the tasks? This can take hours and much disk."
  };

  function openTask(element, props) {
    var task = props.task;
    var address = sensorgate.api + "projects/" + task.project + "/tasks/" + task.id + "/";
    var signal = new sensorgate.requests.Signal();
    var timer = null, state = null, busy = "", trouble = "", align = true;
    var place = h("section.sg-state", { "aria-label": "Camera check" });
    sensorgate.dom.fill(element, place);

    function ask() {
      clearTimeout(timer);
      if (task.partial) return draw();
      sensorgate.requests.persist("GET", address + "state", { signal: signal }, 3).then(show, wrong);
    }

    function show(answer) {
      state = answer;
      trouble = "";
      draw();
      if (UNDER_WAY.indexOf(state.state) >= 0 && !signal.stopped) timer = setTimeout(ask, POLL_MS);
    }

    function wrong(error) {
      // Not there, or not this user's: then there is nothing to say either.
      if (error.stopped || (!state && (error.status === 404 || error.status === 403))) return;
      trouble = error.message;
      draw();
    }

    function act(action, body) {
      if (busy || (CONFIRM[action] && !window.confirm(CONFIRM[action]))) return;
      busy = action;
      clearTimeout(timer);
      draw();
      sensorgate.requests.send("POST", address + action, { json: body || {}, signal: signal }).then(function (answer) {
        busy = "";
        show(answer);
        var created = (answer.tasks || []).length;
        if (created && action !== "check") sensorgate.refresh(task.project, element.closest(".project-list-item"));
      }, function (error) {
        busy = "";
        wrong(error);
      });
    }

    function draw() {
      if (task.partial) return sensorgate.dom.redraw(place, sensorgate.dock.fills(task.id) ? null : h("p", null, INCOMPLETE));
      if (!state) return sensorgate.dom.redraw(place, trouble ? h("p.sg-note", null, trouble) : null);
      var judgement = state.judgement;
      if (state.state === "none" && !state.actions.length && !state.report && !judgement) return sensorgate.dom.redraw(place, null);
      sensorgate.dom.redraw(place, [
        h("h5", null, "Camera check"),
        state.message ? h("p", { role: "status" }, state.message) : null,
        state.progress !== null && state.progress !== undefined ? sensorgate.dom.bar(state.progress, "Progress") : null,
        state.engine_message && tellsEngine(state) ? h("p.sg-small", null, state.engine_message) : null,
        judgement ? judged(judgement) : null,
        trouble ? h("p.sg-note", null, trouble) : null,
        (state.tasks || []).length ? h("p.sg-small", null, "Created from it: " + state.tasks.map(function (each) { return each.name; }).join(", ") + ".") : null,
        buttons(judgement)
      ]);
    }

    function judged(judgement) {
      return h("div.sg-judgement", null,
        judgement.message ? h("p", null, judgement.message) : null,
        h("ul.sg-lines", null, judgement.reasons.map(function (reason) { return h("li", null, reason); })),
        judgement.tasks.length ? h("div.sg-tasks", null, judgement.tasks.map(function (each) {
          return h("section.sg-task", null, h("h6", null, each.name, " ", h("small", null, plural(each.frames, "frame"))),
            h("p.sg-small", null, each.options.map(function (option) {
              return "--" + option.name + (option.value === true ? "" : " " + option.value);
            }).join(" ")));
        })) : null,
        judgement.anchor && state.actions.indexOf("split") >= 0 ? h("label.sg-align", null, h("input", {
          type: "checkbox", checked: align, "data-key": "align", onchange: function (event) { align = event.target.checked; }
        }), h("span", null, "Lay them on the result of “" + judgement.anchor.name + "”, so that they fit each other.")) : null);
    }

    function buttons(judgement) {
      var labels = {
        check: state.state === "none" ? "Check its cameras" : "Check again",
        split: splitLabel(judgement),
        judge: judgement ? "Judge again" : task.status === FAILED_STATUS ? "Why did it fail?" : "Judge the result",
        prepare: "Prepare on this server",
        override: "Let it go as it is"
      };
      var looks = { split: "btn-primary", override: "btn-danger" };
      return h("div.sg-buttons", null,
        ["split", "prepare", "judge", "check", "override"].filter(function (action) {
          return state.actions.indexOf(action) >= 0;
        }).map(function (action) {
          var body = action === "split" && judgement && judgement.anchor ? { align: align } : {};
          return h("button.btn.btn-sm." + (looks[action] || "btn-default"), {
            type: "button", disabled: Boolean(busy), "data-key": action, onclick: function () { act(action, body); }
          }, busy === action ? "Working…" : labels[action]);
        }),
        state.report ? h("a", { href: state.report }, "Report") : null);
    }

    function splitLabel(judgement) {
      var many = judgement ? judgement.tasks.length : 0;
      return many === 1 ? "Create the suggested task" : many ? "Create the " + many + " suggested tasks" : "Split into the suggested tasks";
    }

    function update(next) {
      var before = task;
      task = next.task;
      if (task.status !== before.status || task.partial !== before.partial) ask();
    }

    function close() {
      clearTimeout(timer);
      signal.stop();
    }

    ask();
    return { update: update, close: close };
  }

  /* Where the long work would run matters only to who may start it, or waits for it. */
  function tellsEngine(state) {
    return state.state === "working" || state.actions.indexOf("prepare") >= 0 || state.actions.indexOf("split") >= 0;
  }

  sensorgate.openTask = openTask;
})(window.sensorgate);
