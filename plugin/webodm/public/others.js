/* Chosen files that the gate does not look into: videos, point clouds, lists. Each goes along with the suggested tasks
   that can use it, or it is said before the click why it not sent. Goes by their names alone. */
(function (sensorgate) {
  "use strict";

  var MOST_NAMED = 3;
  // What a processing node takes for the model that others are laid on; a picture by its ending, but no frame.
  var ALIGN = /^align\.(laz|las|tif)$/i;
  var GROUPS = /^image_groups\.txt$/i;
  var VIDEO = /\.(mp4|mov|avi|mkv|lrv|ts|srt)$/i;
  var CLOUD = /\.(laz|las)$/i;
  var PICTURE = /\.(png|bmp|jxl|raw|nef|arw|cr2|cr3|orf|pef|raf|rw2|srw)$/i;

  /* Whether a file of this name goes past the gate though its ending says otherwise. */
  function passesBy(name) {
    return ALIGN.test(name) || GROUPS.test(name);
  }

  /* -> {along: {task key: [[id, name], ...]}, told: [sentence, ...]} for the files `ids` out of `files`. */
  function place(ids, files, verdict) {
    var along = {}, kinds = {};
    verdict.tasks.forEach(function (task) { along[task.key] = []; });
    ids.forEach(function (id) {
      var kind = kindOf(files[id].name, verdict.tasks, files);
      (kinds[kind.words] = kinds[kind.words] || []).push(files[id].name);
      if (kind.name) verdict.tasks.forEach(function (task) { along[task.key].push([id, kind.name]); });
    });
    return {
      along: along,
      told: Object.keys(kinds).sort().map(function (words) { return named(kinds[words]) + ": " + words; })
    };
  }

  /* What happens to a file, and under which name it goes along, if it does. */
  function kindOf(name, tasks, files) {
    if (ALIGN.test(name)) {
      return {
        name: name.toLowerCase(),
        words: tasks.length === 1 ? "sent along. ODM lays the result on it." : "sent along with each task. ODM lays the results on it."
      };
    }
    if (GROUPS.test(name)) {
      if (keepsNames(tasks, files)) return { name: "image_groups.txt", words: "sent along." };
      return { words: "not sent. Its groups do not fit once the files are sorted into tasks of their own." };
    }
    if (VIDEO.test(name)) return { words: "not sent. ODM would cut frames out of a video and mix them with the photos; create a task of its own for it." };
    if (CLOUD.test(name)) return { words: "not sent. ODM takes a point cloud only under the name align.laz or align.las, to lay the result on it." };
    if (PICTURE.test(name)) return { words: "not sent. Pictures of this kind cannot be checked; export them as JPEG or TIFF with their metadata." };
    return { words: "not sent. ODM does not read files of this kind." };
  }

  function keepsNames(tasks, files) {
    return tasks.length === 1 && tasks[0].files.every(function (entry) { return files[entry[0]] && files[entry[0]].name === entry[1]; });
  }

  function named(names) {
    var shown = names.slice(0, MOST_NAMED).join(", ");
    return names.length > MOST_NAMED ? shown + " and " + sensorgate.dom.count(names.length - MOST_NAMED) + " more" : shown;
  }

  sensorgate.others = { place: place, passesBy: passesBy };
})(window.sensorgate);
