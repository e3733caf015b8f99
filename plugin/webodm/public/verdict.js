/* What a check found, as elements. Draws only: what the user does goes to the callbacks in `act`. */
(function (sensorgate) {
  "use strict";

  var h = sensorgate.dom.h, count = sensorgate.dom.count, plural = sensorgate.dom.plural;
  var MOST_LISTED = 200;
  var SPECTRA = { rgb: "colour", multispectral: "multispectral", thermal: "thermal" };
  var SEVERITIES = { error: "Problem", warning: "Warning", info: "Note" };
  var VERDICTS = { consistent: "good", inconsistent: "note", blocked: "bad" };
  var MARKS = { good: "✓", note: "!", bad: "✕", open: "…" };
  var NOT_SENT = "";

  function spectrum(name) {
    return SPECTRA[name] || name || "";
  }

  function number(value, digits) {
    return String(Number(Number(value).toFixed(digits)));
  }

  /* `soFar`: the verdict on a part of the files, which is no reason for green or red yet. */
  function headline(verdict, soFar) {
    var look = soFar ? "open" : VERDICTS[verdict.verdict] || "note";
    return h("p.sg-headline", null, h("span.sg-mark.sg-look-" + look, { "aria-hidden": "true" }, MARKS[look]), h("strong", null, (soFar ? "So far: " : "") + verdict.headline));
  }

  /* One row for each camera as a pilot counts them: a rig is one, and so is a body that writes two picture sizes. */
  function grouped(found) {
    var rows = [], places = {};
    found.forEach(function (camera) {
      var key = camera.camera || camera.name;
      if (places[key] === undefined) {
        places[key] = rows.length;
        rows.push({ camera: camera, bands: [], sizes: [], focals: [], frames: 0 });
      }
      var row = rows[places[key]];
      var size = camera.width && camera.height ? camera.width + " × " + camera.height : "unknown";
      row.frames += camera.frames;
      if (row.sizes.indexOf(size) < 0) row.sizes.push(size);
      if (camera.band && row.bands.indexOf(camera.band) < 0) row.bands.push(camera.band);
      if (camera.focal_mm) row.focals.push(camera.focal_mm);
    });
    return rows;
  }

  function cameras(found) {
    if (!found.length) return null;
    var judged = found.some(function (camera) { return camera.payload; });
    var head = ["Camera", judged ? "Kind" : null, "Picture", judged ? "Focal length" : null, "Frames"];
    function row(each) {
      var camera = each.camera;
      return h("tr", null,
        h("th", { scope: "row" }, camera.name || "Unknown camera"),
        judged ? h("td", null, spectrum(camera.spectrum) + (each.bands.length > 1 ? ": " + each.bands.join(", ") : "")) : null,
        h("td", null, each.sizes.map(function (size) { return h("div.sg-whole", null, size); })),
        judged ? h("td.sg-whole", null, focal(each.focals)) : null,
        h("td.sg-number", null, count(each.frames)));
    }
    return [h("h5", null, "Cameras found"), h("div.sg-scroll", null, h("table.sg-table", null,
      h("thead", null, h("tr", null, head.filter(Boolean).map(function (name) {
        return h(name === "Frames" ? "th.sg-number" : "th", { scope: "col" }, name);
      }))),
      h("tbody", null, grouped(found).map(row))))];
  }

  function focal(values) {
    if (!values.length) return "unknown";
    var least = number(Math.min.apply(null, values), 2), most = number(Math.max.apply(null, values), 2);
    return (least === most ? least : least + " to " + most) + " mm";
  }

  function lines(texts) {
    return h("ul.sg-lines", null, texts.map(function (text) { return h("li", null, text); }));
  }

  function comparison(verdict) {
    if (!verdict.odm.length && !verdict.ours.length) return null;
    return [
      h("div.sg-versus", null,
        h("section", null, h("h5", null, "If you upload this as one task"), lines(verdict.odm)),
        h("section.sg-ours", null, h("h5", null, "What we suggest"), lines(verdict.ours))),
      verdict.engine_message && verdict.verdict !== "consistent" ? h("p.sg-small.sg-engine", null, verdict.engine_message) : null
    ];
  }

  function optionWords(option) {
    return "--" + option.name + (option.value === true ? "" : " " + (typeof option.value === "object" ? JSON.stringify(option.value) : option.value));
  }

  function mover(payload, verdict, act) {
    var current = verdict.tasks.some(function (task) { return task.key === payload.task; }) ? payload.task : NOT_SENT;
    var choices = verdict.tasks.map(function (task) { return [task.key, task.name]; });
    choices.push([NOT_SENT, "leave out"]);
    return h("select.form-control.input-sm", {
      "aria-label": "Where " + payload.name + " goes", "data-key": "move-" + payload.id, disabled: act.busy,
      onchange: function (event) { act.move(payload.id, event.target.value); }
    }, choices.map(function (choice) {
      return h("option", { value: choice[0], selected: choice[0] === current }, choice[1]);
    }));
  }

  function payloadRow(payload, verdict, act) {
    var bands = (payload.bands || []).filter(Boolean).join(", ");
    return h("li.sg-payload", null,
      h("span", null, payload.name, h("small", null, " " + plural(payload.frames, "frame") + (bands ? " · " + bands : ""))),
      verdict.payloads.length > 1 ? mover(payload, verdict, act) : null);
  }

  function taskCard(task, verdict, act) {
    var payloads = verdict.payloads.filter(function (payload) { return payload.task === task.key; });
    var texts = Object.keys(task.texts || {}).sort();
    return h("section.sg-task", null,
      h("h6", null, task.name, " ", h("small", null, plural(task.frames, "frame") + (spectrum(task.spectrum) ? " · " + spectrum(task.spectrum) : ""))),
      payloads.length ? h("ul.sg-payloads", null, payloads.map(function (payload) { return payloadRow(payload, verdict, act); })) : null,
      h("div.sg-options.sg-small", null, task.options.length ? task.options.map(function (option) {
        return h("div", null, h("code", null, optionWords(option)), " ", (task.reasons || {})[option.name] || "");
      }) : h("div", null, "The options chosen in the form above.")),
      texts.length ? h("p.sg-small", null, "With it: " + texts.join(", ") + ", rewritten for this task.") : null);
  }

  /* `base`: the name that the user gave; each task's own is put behind it. */
  function tasks(verdict, act, base) {
    if (!verdict.tasks.length) return null;
    var apart = verdict.payloads.filter(function (payload) {
      return !verdict.tasks.some(function (task) { return task.key === payload.task; });
    });
    return [
      h("h5", null, plural(verdict.tasks.length, "task") + " to create"),
      h("p.sg-small.sg-names", null, verdict.tasks.length > 1 ? ["Their names begin with “", base, " -”."] : ["Its name is “", base, "”."]),
      h("div.sg-tasks", null,
        verdict.tasks.map(function (task) { return taskCard(task, verdict, act); }),
        apart.length ? h("section.sg-task.sg-apart", null, h("h6", null, "Left out"),
          h("ul.sg-payloads", null, apart.map(function (payload) { return payloadRow(payload, verdict, act); }))) : null)
    ];
  }

  function rules(verdict, act) {
    if (!verdict.rules.length) return null;
    return h("fieldset.sg-rules", { disabled: act.busy }, h("legend", null, "What we change. Untick what you do not want:"),
      verdict.rules.map(function (rule) {
        return h("label", null, h("input", {
          type: "checkbox", checked: rule.on, "data-key": "rule-" + rule.id,
          onchange: function (event) { act.rule(rule.id, event.target.checked); }
        }), h("span", null, rule.text, rule.frames ? h("small", null, " (" + plural(rule.frames, "frame") + ")") : null));
      }));
  }

  function others(told) {
    return told.length ? [h("h5", null, "Other files"), lines(told)] : null;
  }

  function fold(key, title, children, act) {
    return h("details.sg-fold", {
      open: Boolean(act.open[key]), ontoggle: function (event) { act.open[key] = event.target.open; }
    }, h("summary", { "data-key": "fold-" + key }, title), children);
  }

  function findings(verdict, act) {
    if (!verdict.findings.length) return null;
    var told = ["error", "warning", "info"].map(function (severity) {
      var many = verdict.findings.filter(function (finding) { return finding.severity === severity; }).length;
      return many ? plural(many, SEVERITIES[severity].toLowerCase()) : "";
    }).filter(Boolean).join(", ");
    return fold("findings", "Why: " + told, h("ul.sg-findings", null, bySeverity(verdict.findings).map(function (finding) {
      return h("li.sg-" + finding.severity, null,
        h("p", null, h("strong", null, SEVERITIES[finding.severity] || finding.severity), " ", finding.message),
        finding.remedy ? h("p.sg-small", null, finding.remedy) : null);
    })), act);
  }

  function bySeverity(findings) {
    return ["error", "warning", "info"].reduce(function (sorted, severity) {
      return sorted.concat(findings.filter(function (finding) { return finding.severity === severity; }));
    }, []);
  }

  function leftOut(left, act) {
    if (!left.length) return null;
    return fold("left", plural(left.length, "file") + (left.length === 1 ? " is left out" : " are left out"), [
      h("ul.sg-lines", null, left.slice(0, MOST_LISTED).map(function (each) {
        return h("li", null, h("code", null, each.path), " ", each.message || each.reason);
      })),
      left.length > MOST_LISTED ? h("p.sg-small", null, "And " + count(left.length - MOST_LISTED) + " more.") : null
    ], act);
  }

  sensorgate.views = {
    headline: headline, cameras: cameras, comparison: comparison, tasks: tasks, rules: rules, others: others, findings: findings, leftOut: leftOut
  };
})(window.sensorgate);
