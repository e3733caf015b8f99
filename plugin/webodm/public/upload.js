/* Creating tasks and filling them through WebODM's own task API: a partial task, each file under its new name,
   then the commit that starts it. Files go up in parallel and are tried again; what is up stays up. */
(function (sensorgate) {
  "use strict";

  var requests = sensorgate.requests;
  var PARALLEL = 4;
  var CHUNK_BYTES = 8000000;
  var SLOW_CHUNK_BYTES = 1000000;
  var CHUNK_TRIES = 5;
  var FILE_TRIES = 12;
  var TASK_TRIES = 6;
  var LONGEST_WAIT_MS = 60000;
  var FIRST_WAIT_MS = 2500;

  /* WebODM's own setting for bad lines. */
  function unstable() {
    try {
      return Boolean(window.localStorage.getItem("unstable_connection"));
    } catch (forbidden) {
      return false;
    }
  }

  /* The user's options with the proposed ones laid over; WebODM refuses values that are false, zero or empty. */
  function mergeOptions(own, proposed) {
    var names = {};
    proposed.forEach(function (option) { names[option.name] = true; });
    return (own || []).filter(function (option) { return option && !names[option.name]; }).concat(proposed)
      .filter(function (option) { return option.value; })
      .map(function (option) { return { name: option.name, value: option.value }; });
  }

  function mergeTags(own, proposed) {
    return (own || []).concat(proposed || []).filter(function (tag, index, all) { return all.indexOf(tag) === index; });
  }

  /* `order`: {project, session, name, choices, info (WebODM's task form), tasks: [{key, name, options, tags, texts,
     files: [[File, name], ...]}]} */
  function Upload(order) {
    this.order = order;
    this.signal = new requests.Signal();
    this.running = false;
    this.cancelled = false;
    this.listeners = [];
    this.rows = order.tasks.map(function (task) {
      var texts = Object.keys(task.texts || {}).sort().map(function (name) {
        return [new Blob([task.texts[name]], { type: "text/plain" }), name];
      });
      var parts = task.files.concat(texts);
      return {
        task: task, name: order.tasks.length > 1 ? order.name + " - " + task.name : order.name, parts: parts,
        total: parts.reduce(function (sum, part) { return sum + part[0].size; }, 0),
        up: {}, sent: {}, count: 0, id: null, claimed: false, state: "waiting", message: "", note: ""
      };
    });
  }

  Upload.prototype.changed = function () {
    this.listeners.forEach(function (listener) { listener(); });
  };

  Upload.prototype.sentBytes = function (row) {
    return Math.min(row.total, Object.keys(row.sent).reduce(function (sum, name) { return sum + row.sent[name]; }, 0));
  };

  Upload.prototype.done = function () {
    return this.rows.every(function (row) { return row.state === "done"; });
  };

  Upload.prototype.started = function () {
    return this.rows.filter(function (row) { return row.state === "done"; });
  };

  /* Run what is not done yet: also how a failed run is taken up again. */
  Upload.prototype.run = function () {
    var self = this;
    if (this.running || this.cancelled) return Promise.resolve();
    this.running = true;
    this.rows.forEach(function (row) {
      if (row.state === "failed") { row.state = "waiting"; row.message = ""; }
    });
    var all = this.rows.reduce(function (before, row) {
      return before.then(function () { return row.state === "waiting" && !self.signal.stopped ? self.runRow(row) : null; });
    }, Promise.resolve());
    return all.then(function () {
      self.running = false;
      self.changed();
    });
  };

  Upload.prototype.runRow = function (row) {
    var self = this;
    function step(state) {
      row.state = state;
      row.message = "";
      self.changed();
    }
    step("creating");
    return this.create(row)
      .then(function () { step("uploading"); return self.sendAll(row); })
      .then(function () { step("starting"); return self.commit(row); })
      .then(function () { step("done"); })
      .catch(function (error) {
        if (error.stopped) return;
        row.state = "failed";
        row.message = error.message;
        self.changed();
      });
  };

  Upload.prototype.persist = function (row, method, url, json) {
    var self = this;
    return requests.persist(method, url, { json: json, signal: this.signal }, TASK_TRIES, function (error) {
      row.message = error.message + " Trying again…";
      self.changed();
    });
  };

  Upload.prototype.create = function (row) {
    if (row.id) return this.claim(row);
    var self = this, info = this.order.info || {}, node = info.selectedNode || { key: "auto" };
    var body = {
      name: row.name, partial: true, options: mergeOptions(info.options, row.task.options),
      tags: mergeTags(info.tags, row.task.tags), auto_processing_node: node.key === "auto"
    };
    if (node.id !== undefined && node.id !== null && node.key !== "auto") body.processing_node = node.id;
    if (info.alignTo && info.alignTo !== "auto") body.align_to = info.alignTo;
    if (info.resizeMode === 1 && info.resizeSize) body.resize_to = info.resizeSize;
    // Neither repeated nor broken off: a create whose answer is lost leaves an empty task behind.
    return requests.send("POST", "/api/projects/" + this.order.project + "/tasks/", { json: body })
      .then(function (task) {
        if (!task || !task.id) throw new Error("The server did not create the task.");
        row.id = task.id;
        if (!self.signal.stopped) return self.claim(row);
        return self.remove(row).then(function () { throw requests.stopped(); });
      });
  };

  Upload.prototype.claim = function (row) {
    if (row.claimed) return Promise.resolve();
    var told = { task: row.id, key: row.task.key, off: this.order.choices.off, moves: this.order.choices.moves };
    return this.persist(row, "POST", sensorgate.api + "sessions/" + this.order.session + "/claim", told)
      .then(function (answer) {
        row.claimed = true;
        row.note = (answer && answer.message) || "";
      }, function (error) {
        if (error.stopped || error.retry) throw error;
        // The choices cannot be noted: the upload is worth more, and hold mode will look at what arrives.
        row.claimed = true;
      });
  };

  Upload.prototype.url = function (row, action) {
    return "/api/projects/" + this.order.project + "/tasks/" + row.id + "/" + action + "/";
  };

  Upload.prototype.sendAll = function (row) {
    var self = this, waiting = row.parts.filter(function (part) { return !row.up[part[1]]; });
    var failure = null;
    function lane() {
      if (!waiting.length || failure) return Promise.resolve();
      var part = waiting.shift();
      return self.sendPart(row, part, 1).then(function () {
        row.up[part[1]] = true;
        row.count += 1;
        row.sent[part[1]] = part[0].size;
        row.message = "";
        self.changed();
        return lane();
      }, function (error) { failure = failure || error; });
    }
    var lanes = [];
    for (var i = 0; i < (unstable() ? 1 : PARALLEL); i++) lanes.push(lane());
    return Promise.all(lanes).then(function () { if (failure) throw failure; });
  };

  Upload.prototype.sendPart = function (row, part, attempt) {
    var self = this, size = unstable() ? SLOW_CHUNK_BYTES : CHUNK_BYTES;
    row.sent[part[1]] = 0;
    var sent = part[0].size > size ? this.sendChunks(row, part, size) : this.sendForm(row, part, part[0], 0, null);
    return sent.then(function (answer) {
      var stored = answer && answer.uploaded ? answer.uploaded[part[1]] : undefined;
      if (stored === part[0].size) return;
      var error = new Error(part[1] + " did not arrive whole.");
      error.retry = true;
      throw error;
    }).catch(function (error) {
      if (error.stopped) throw error;
      row.sent[part[1]] = 0;
      if (!error.retry || attempt >= FILE_TRIES) {
        var final = new Error(part[1] + ": " + error.message);
        final.status = error.status;
        throw final;
      }
      row.message = error.message + " Trying again…";
      self.changed();
      var wait = Math.max(error.waitMs || 0, Math.min(LONGEST_WAIT_MS, FIRST_WAIT_MS * attempt));
      return requests.pause(wait, self.signal).then(function () { return self.sendPart(row, part, attempt + 1); });
    });
  };

  Upload.prototype.sendForm = function (row, part, blob, offset, fields) {
    var self = this, form = new FormData();
    Object.keys(fields || {}).forEach(function (name) { form.append(name, fields[name]); });
    form.append("images", blob, part[1]);
    return requests.send("POST", this.url(row, "upload"), {
      form: form, signal: this.signal, progress: function (loaded) {
        row.sent[part[1]] = offset + Math.min(loaded, blob.size);
        self.changed();
      }
    });
  };

  /* A large file goes up piece by piece; the server puts pieces of one id behind each other. */
  Upload.prototype.sendChunks = function (row, part, size) {
    var self = this, file = part[0], id = uuid(), count = Math.ceil(file.size / size);
    function chunk(index, attempt) {
      var offset = index * size;
      return self.sendForm(row, part, file.slice(offset, Math.min(file.size, offset + size)), offset, {
        dzuuid: id, dzchunkindex: index, dztotalfilesize: file.size, dzchunksize: size, dztotalchunkcount: count, dzchunkbyteoffset: offset
      }).then(function (answer) {
        return index + 1 < count ? chunk(index + 1, 1) : answer;
      }, function (error) {
        // A piece that may have arrived must not be sent twice: then the whole file starts again under another id.
        if (error.stopped || !error.retry || error.status === 0 || attempt >= CHUNK_TRIES) throw error;
        return requests.pause(Math.max(error.waitMs, FIRST_WAIT_MS), self.signal).then(function () { return chunk(index, attempt + 1); });
      });
    }
    return chunk(0, 1);
  };

  Upload.prototype.commit = function (row) {
    return this.persist(row, "POST", this.url(row, "commit"), {}).then(function (task) {
      if (!task || !task.id) throw new Error("The server did not start the task.");
    });
  };

  /* Stop, and take away the tasks that are not complete. Those that were started stay. */
  Upload.prototype.cancel = function () {
    var self = this;
    this.cancelled = true;
    this.signal.stop();
    var open = this.rows.filter(function (row) { return row.state !== "done"; });
    open.forEach(function (row) { row.state = "cancelled"; row.message = ""; });
    this.changed();
    return Promise.all(open.filter(function (row) { return row.id; }).map(function (row) { return self.remove(row); }));
  };

  Upload.prototype.remove = function (row) {
    var self = this;
    return requests.send("POST", this.url(row, "remove"), { json: {} }).catch(function () {
      row.message = "This incomplete task is still in the list: delete it there.";
      self.changed();
    });
  };

  function uuid() {
    var random = window.crypto.getRandomValues(new Uint8Array(16));
    return Array.prototype.map.call(random, function (byte) { return ("0" + byte.toString(16)).slice(-2); }).join("");
  }

  sensorgate.Upload = Upload;
})(window.sensorgate);
