/* One check of the chosen files: headers are read here, sent in batches, and judged on the server, again and again
   while reading goes on. Holds no view; `changed` is called when there is something new to show. */
(function (sensorgate) {
  "use strict";

  var READERS = 6;
  var SENDERS = 3;
  var FIRST_RUNS = 8;
  var FIRST_RUN_FILES = 6;
  var BATCH_SHARE = 0.9;
  var TRIES = 6;
  var MOST_ROUNDS = 16;
  var VERDICT_PAUSE_MS = 1500;
  var IMAGES = /\.(jpe?g|jpe|tiff?|dng)$/i;
  var MASKS = /_mask\.[a-z]+$/i;
  var TEXTS = /\.txt$/i;
  var GEO_NAME = "geo.txt";

  function Check(project, changed) {
    this.project = project;
    this.changed = changed;
    this.known = new Set();
    this.files = [];
    this.choices = { off: [], moves: {} };
    this.revision = 0;
    this.signal = new sensorgate.requests.Signal();
    this.reset();
  }

  Check.prototype.reset = function () {
    this.session = null;
    this.limits = null;
    this.phase = "starting";
    this.message = "";
    this.queue = [];
    this.texts = [];
    this.others = [];
    this.reading = 0;
    this.batch = [];
    this.batches = [];
    this.sending = 0;
    this.sentBatches = 0;
    this.rounds = {};
    this.outstanding = 0;
    this.done = 0;
    this.images = 0;
    this.imageBytes = 0;
    this.sentBytes = 0;
    this.cameras = [];
    this.unread = [];
    this.verdict = null;
    this.verdictWhole = false;
    this.verdictFinal = false;
    this.asking = false;
    this.lastAsked = 0;
    this.timer = null;
  };

  /* All files chosen so far; those already known are passed over. */
  Check.prototype.add = function (files) {
    var self = this, before = this.files.length;
    Array.prototype.forEach.call(files || [], function (file) {
      if (!file || self.known.has(file) || file.accepted === false) return;
      self.known.add(file);
      self.files.push(file);
    });
    if (this.files.length === before) return;
    this.revision += 1;
    this.verdictWhole = false;
    if (this.phase === "failed") return this.restart();
    this.sortFrom(before);
    if (!this.session && this.phase !== "opening") this.open();
    else this.goOn();
    this.changed();
  };

  Check.prototype.sortFrom = function (first) {
    var waiting = this.queue;
    this.queue = [];
    for (var id = first; id < this.files.length; id++) this.sort(id);
    this.queue = waiting.concat(spread(this.queue));
  };

  Check.prototype.sort = function (id) {
    var file = this.files[id];
    if (isSent(file)) {
      this.queue.push(id);
      this.images += 1;
      this.imageBytes += file.size;
      this.verdictFinal = false;
    } else if (TEXTS.test(file.name) && !sensorgate.others.passesBy(file.name)) {
      this.texts.push(id);
      this.verdictFinal = false;
    } else {
      this.others.push(id);
    }
  };

  Check.prototype.path = function (id) {
    var file = this.files[id];
    return file.fullPath || file.webkitRelativePath || file.name;
  };

  /* From the beginning, after a failure. */
  Check.prototype.restart = function () {
    this.signal.stop();
    this.signal = new sensorgate.requests.Signal();
    clearTimeout(this.timer);
    this.reset();
    this.sortFrom(0);
    this.open();
    this.changed();
  };

  Check.prototype.close = function () {
    clearTimeout(this.timer);
    this.signal.stop();
  };

  Check.prototype.fail = function (error) {
    if (error.stopped) return;
    this.phase = "failed";
    this.message = error.message;
    this.signal.stop();
    clearTimeout(this.timer);
    this.changed();
  };

  Check.prototype.post = function (path, body) {
    var self = this;
    return sensorgate.requests.persist("POST", sensorgate.api + path, { json: body, signal: this.signal }, TRIES, function (error) {
      self.message = (error.status === 429 ? error.message : "The connection is slow or broken.") + " Trying again…";
      self.changed();
    }).then(function (answer) {
      self.message = "";
      return answer;
    });
  };

  Check.prototype.open = function () {
    var self = this, signal = this.signal;
    this.phase = "opening";
    this.post("sessions", { project: this.project }).then(function (answer) {
      self.session = answer.session;
      self.limits = answer.limits;
      self.hold = answer.hold;
      self.mayOverride = answer.may_override;
      self.phase = "reading";
      if (self.images > answer.limits.files) {
        throw new Error("More than " + sensorgate.dom.count(answer.limits.files) + " images cannot be checked at once. "
          + "Choose one flight at a time.");
      }
      self.goOn();
    }).catch(function (error) { if (signal === self.signal) self.fail(error); });
  };

  Check.prototype.goOn = function () {
    if (!this.session || this.phase === "failed") return;
    this.phase = "reading";
    while (this.texts.length) this.sendText(this.texts.shift());
    while (this.queue.length && this.reading < READERS && this.batches.length < SENDERS) this.readOne(this.queue.shift());
    if (this.batch.length && !this.queue.length && !this.reading) this.closeBatch();
    while (this.batches.length && this.sending < SENDERS) this.sendBatch(this.batches.shift());
    if (!this.queue.length && !this.reading && !this.batch.length && !this.batches.length && !this.sending && !this.outstanding) {
      this.phase = this.verdictFinal ? "ready" : "judging";
      if (!this.verdictFinal) this.ask();
    }
  };

  Check.prototype.sendText = function (id) {
    var self = this, file = this.files[id], signal = this.signal;
    if (file.size > this.limits.control_bytes) {
      this.giveUp(id, "The file is too large to be ground control or positions.");
      return;
    }
    this.outstanding += 1;
    sensorgate.headers.readRanges(file, [[0, file.size]]).then(function (read) {
      var text = new TextDecoder().decode(read[0][1]);
      return self.post("sessions/" + self.session + "/control", { kind: file.name.toLowerCase() === GEO_NAME ? "geo" : "gcp", text: text });
    }).catch(function (error) {
      if (error.stopped || signal !== self.signal) return;
      self.giveUp(id, error.message);
    }).then(function () {
      if (signal !== self.signal) return;
      self.outstanding -= 1;
      self.goOn();
      self.changed();
    });
  };

  /* Read a file's header, with the [offset, length] pairs in `more` that the server asked for. */
  Check.prototype.readOne = function (id, before, more) {
    var self = this, file = this.files[id], signal = this.signal;
    this.reading += 1;
    var read = more
      ? sensorgate.headers.readRanges(file, more).then(function (ranges) { return before.concat(ranges); })
      : MASKS.test(file.name) ? Promise.resolve([]) : sensorgate.headers.read(file);
    read.then(function (ranges) {
      if (signal !== self.signal) return;
      self.reading -= 1;
      var length = ranges.reduce(function (sum, range) { return sum + range[1].length; }, 0);
      if (length > self.limits.file_bytes) self.giveUp(id, "Its header is too large to be checked.");
      else self.put(id, ranges, Math.ceil(length * 4 / 3) + 200);
      self.goOn();
    }, function (error) {
      if (signal !== self.signal) return;
      self.reading -= 1;
      self.giveUp(id, error.cut ? error.message : "The file cannot be read. Is the card still in?");
      self.goOn();
    });
  };

  Check.prototype.giveUp = function (id, message) {
    this.unread.push({ id: id, path: this.path(id), message: message });
    if (isSent(this.files[id])) this.done += 1;
    this.changed();
  };

  Check.prototype.put = function (id, ranges, size) {
    var waiting = this.batch.reduce(function (sum, entry) { return sum + entry.size; }, 0);
    if (this.batch.length && waiting + size > BATCH_SHARE * this.limits.batch_bytes) this.closeBatch();
    this.batch.push({ id: id, ranges: ranges, size: size });
    var most = this.sentBatches ? this.limits.batch_files : Math.min(FIRST_RUNS * FIRST_RUN_FILES, this.limits.batch_files);
    if (this.batch.length >= most) this.closeBatch();
  };

  Check.prototype.closeBatch = function () {
    this.batches.push(this.batch);
    this.sentBatches += 1;
    this.batch = [];
  };

  Check.prototype.sendBatch = function (batch) {
    var self = this, signal = this.signal;
    var body = {
      files: batch.map(function (entry) {
        var file = self.files[entry.id];
        return {
          id: entry.id, path: self.path(entry.id), size: file.size, modified: file.lastModified || 0,
          ranges: entry.ranges.map(function (range) { return [range[0], base64(range[1])]; })
        };
      })
    };
    this.sending += 1;
    this.sentBytes += batch.reduce(function (sum, entry) { return sum + entry.size; }, 0);
    this.post("sessions/" + this.session + "/headers", body).then(function (answer) {
      self.sending -= 1;
      self.answered(batch, answer);
      self.goOn();
      if (self.phase === "reading") self.askSoon();
      self.changed();
    }).catch(function (error) {
      if (signal === self.signal) self.fail(error);
    });
  };

  Check.prototype.answered = function (batch, answer) {
    var self = this, ranges = {}, again = {};
    batch.forEach(function (entry) { ranges[entry.id] = entry.ranges; });
    (answer.need || []).forEach(function (need) {
      if (!ranges[need.id] || !(need.length > 0)) return;
      self.rounds[need.id] = (self.rounds[need.id] || 0) + 1;
      again[need.id] = true;
      if (self.rounds[need.id] > MOST_ROUNDS) self.giveUp(need.id, "Its header cannot be followed.");
      else self.readOne(need.id, ranges[need.id], [[need.offset, need.length]]);
    });
    (answer.broken || []).forEach(function (broken) {
      self.unread.push({ id: broken.id, path: broken.path || self.path(broken.id), message: broken.message, told: true });
    });
    (answer.cameras || []).forEach(function (camera) {
      var same = self.cameras.filter(function (each) {
        return each.name === camera.name && each.width === camera.width && each.height === camera.height;
      })[0];
      if (same) same.frames += camera.frames;
      else self.cameras.push({ name: camera.name, width: camera.width, height: camera.height, frames: camera.frames });
    });
    this.done += batch.filter(function (entry) { return !again[entry.id]; }).length;
  };

  /* What the user ticked and moved; the verdict follows. */
  Check.prototype.choose = function (choices) {
    this.choices = choices;
    this.revision += 1;
    this.verdictFinal = false;
    this.goOn();
    this.changed();
  };

  Check.prototype.askSoon = function () {
    var self = this;
    if (this.asking || this.timer) return;
    var wait = this.verdict ? Math.max(0, this.lastAsked + VERDICT_PAUSE_MS - performance.now()) : 0;
    this.timer = setTimeout(function () {
      self.timer = null;
      if (self.phase === "reading") self.ask();
    }, wait);
  };

  Check.prototype.ask = function () {
    if (this.asking) return;
    var self = this, signal = this.signal, revision = this.revision, chosen = this.files.length, began = performance.now();
    var whole = this.phase === "judging";
    function final() { return whole && revision === self.revision; }
    this.asking = true;
    this.post("sessions/" + this.session + "/verdict", this.choices).then(function (answer) {
      self.verdict = answer;
      self.verdictWhole = whole && chosen === self.files.length;
      self.asked(began, final());
    }).catch(function (error) {
      if (error.stopped || signal !== self.signal) return;
      if (error.status !== 409) return self.fail(error);
      self.message = final() ? error.message : "";
      self.asked(began, final());
    });
  };

  /* Asking costs the server work: the pause grows with the time that it took. */
  Check.prototype.asked = function (began, final) {
    this.asking = false;
    this.lastAsked = performance.now() + 2 * (performance.now() - began);
    this.verdictFinal = final;
    this.goOn();
    this.changed();
  };

  /* Short runs from all over the list first: cards are chosen folder by folder, and the first verdict shall know of
     every camera. Runs, because the bands of a capture lie side by side. */
  function spread(ids) {
    var step = Math.floor(ids.length / FIRST_RUNS), first = [], rest = [];
    ids.forEach(function (id, index) {
      var early = step > FIRST_RUN_FILES && index % step < FIRST_RUN_FILES && index < step * FIRST_RUNS;
      (early ? first : rest).push(id);
    });
    return first.concat(rest);
  }

  /* Masks go by their name alone: nobody looks into them. */
  function isSent(file) {
    return (IMAGES.test(file.name) || MASKS.test(file.name)) && !sensorgate.others.passesBy(file.name);
  }

  function base64(data) {
    var text = "";
    for (var i = 0; i < data.length; i += 8192) text += String.fromCharCode.apply(null, data.subarray(i, i + 8192));
    return btoa(text);
  }

  sensorgate.Check = Check;
})(window.sensorgate);
