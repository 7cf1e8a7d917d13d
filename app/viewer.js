// A frame that can be zoomed and clicked, with marks drawn over it. Places are pixels of the recording, integers at pixel centres.
export default {
  template: `
    <div class="viewer" ref="root" tabindex="-1" :data-shown="shown" :class="{ picking: mode === 'pick' }"
         @pointerdown="down" @pointermove="move" @pointerup="up" @pointerleave="leave" @wheel.prevent="wheel"
         @contextmenu.prevent>
      <img ref="img" :src="current || undefined" draggable="false" alt="frame of the recording" v-show="current" :class="{ lit }"
           :style="{ left: ox + 'px', top: oy + 'px', width: width * scale + 'px', height: height * scale + 'px',
                     imageRendering: scale > 2.5 ? 'pixelated' : 'auto' }" />
      <svg class="over" width="100%" height="100%">
        <polyline v-for="(line, i) in still.lines || []" :key="'l' + i" :points="path(line.points)" fill="none"
                  :stroke="line.colour" stroke-width="1.4" :opacity="line.opacity || 0.85" />
        <text v-for="(t, i) in still.texts || []" :key="'t' + i" :x="sx(t.u)" :y="sy(t.v)" class="note" :fill="t.colour">{{ t.text }}</text>
        <polyline v-for="(line, i) in moving.lines || []" :key="'m' + i" :points="path(line.points)" fill="none"
                  :stroke="line.colour" stroke-width="2" />
        <circle v-for="(p, i) in moving.spots || []" :key="'s' + i" :cx="sx(p[0])" :cy="sy(p[1])" r="7" class="spot" />
        <g v-for="(m, i) in [...(still.marks || []), ...(moving.marks || [])]" :key="'k' + i" :class="{ chosen: m.chosen }">
          <line v-if="m.arrow" :x1="sx(m.u)" :y1="sy(m.v)" :x2="sx(m.u + m.arrow[0])" :y2="sy(m.v + m.arrow[1])" class="arrow" />
          <g v-if="m.shape === 'cross'" class="cross">
            <path :d="crossPath(m)" class="under" /><path :d="crossPath(m)" :stroke="m.colour" class="ink" />
          </g>
          <g v-else>
            <circle :cx="sx(m.u)" :cy="sy(m.v)" r="11" class="under" />
            <circle :cx="sx(m.u)" :cy="sy(m.v)" r="11" class="ink" :stroke="m.colour" />
            <circle :cx="sx(m.u)" :cy="sy(m.v)" r="1.5" :fill="m.colour" />
          </g>
          <text :x="sx(m.u) + 15" :y="sy(m.v) - 9" class="label" :fill="m.colour">{{ m.label }}</text>
        </g>
      </svg>
      <canvas ref="loupe" class="loupe" width="176" height="176" v-show="loupeOn"></canvas>
      <div class="where" v-show="pointer">{{ pointer }}</div>
      <div class="tools">
        <button type="button" aria-label="Zoom in" title="Zoom in (+)" @pointerdown.stop @click.stop="zoomBy(1.6)">+</button>
        <button type="button" aria-label="Zoom out" title="Zoom out (-)" @pointerdown.stop @click.stop="zoomBy(1 / 1.6)">−</button>
        <button type="button" aria-label="Fit" title="Whole frame (0)" @pointerdown.stop @click.stop="fit()">Fit</button>
        <button type="button" aria-label="Brighter" title="Brighter picture (B)" :aria-pressed="lit" @pointerdown.stop @click.stop="light()">{{ lit ? "Darker" : "Brighter" }}</button>
      </div>
      <div class="empty" v-if="!current">{{ empty }}</div>
    </div>`,
  props: {
    src: String, width: Number, height: Number, count: Number, overlay: String, overlay_frame: String, mode: String, empty: String,
  },
  data() {
    return {
      current: "", shown: "", wanted: "", loading: false, scale: 1, ox: 0, oy: 0, fitted: true, pressed: null, pointer: "",
      loupeOn: false, still: {}, moving: {}, waiting: null, lit: false,
    };
  },
  watch: {
    src(value) { this.load(value, null); },
    overlay(value) { this.still = this.parsed(value); },
    overlay_frame(value) { this.moving = this.parsed(value); },
    width() { this.$nextTick(this.fit); },
    height() { this.$nextTick(this.fit); },
  },
  mounted() {
    this.still = this.parsed(this.overlay);
    this.moving = this.parsed(this.overlay_frame);
    this.observer = new ResizeObserver(() => this.fitted ? this.fit() : this.keepInside());
    this.observer.observe(this.$refs.root);
    this.fit();
    if (this.src) this.load(this.src, null);
  },
  unmounted() { this.observer.disconnect(); },
  methods: {
    // the frame and what is drawn over it change together, once the picture is there; only the newest wish is kept
    show(src, moving) { this.load(src, this.parsed(moving)); },
    over(moving) {
      const what = this.parsed(moving);
      const coming = this.waiting || this.coming;  // a picture that is still on its way takes it along
      if (coming) coming.moving = what; else this.moving = what;
    },
    parsed(text) { return text ? JSON.parse(text) : {}; },
    load(src, moving) {
      if (!src) { this.current = this.shown = ""; return; }
      this.waiting = { src, moving };
      if (!this.loading) this.next();
    },
    next() {
      const job = this.coming = this.waiting;
      this.waiting = null;
      if (!job) return;
      this.loading = true;
      const picture = new Image();
      const done = () => { this.loading = false; this.next(); };
      picture.onload = () => picture.decode().catch(() => {}).then(() => {
        if (job.dropped) return done();
        this.current = picture.src;
        this.picture = picture;
        if (job.moving) this.moving = job.moving;
        this.$nextTick(() => { this.shown = (job.src.match(/frame\/\d+\/(\d+)/) || ["", ""])[1]; });
        done();
        this.ahead(job.src);
      });
      picture.onerror = () => { this.shown = "error"; done(); };
      picture.src = (window.path_prefix || "") + job.src;
    },
    // no picture that is on its way any more; the frame that is seen, -1 = none
    stay() {
      if (this.coming) this.coming.dropped = true;
      this.waiting = this.coming = null;
      return /^\d+$/.test(this.shown) ? Number(this.shown) : -1;
    },
    // the frame that the next step of the same length asks for
    ahead(src) {
      const number = (s) => Number((s.match(/frame\/\d+\/(\d+)/) || [0, -1])[1]);
      const here = number(src), step = here - (this.before ?? here);
      this.before = here;
      if (step && here + step >= 0 && here + step < this.count && !this.waiting) new Image().src = (window.path_prefix || "") + src.replace(/\d+\.jpg/, `${here + step}.jpg`);
    },
    light() { this.lit = !this.lit; },
    sx(u) { return (u + 0.5) * this.scale + this.ox; },
    sy(v) { return (v + 0.5) * this.scale + this.oy; },
    path(points) { return points.map((p) => this.sx(p[0]).toFixed(1) + "," + this.sy(p[1]).toFixed(1)).join(" "); },
    crossPath(m) {
      const x = this.sx(m.u), y = this.sy(m.v);
      return `M${x - 13},${y}H${x - 4}M${x + 4},${y}H${x + 13}M${x},${y - 13}V${y - 4}M${x},${y + 4}V${y + 13}`;
    },
    box() { return this.$refs.root.getBoundingClientRect(); },
    fit() {
      const box = this.box();
      if (!box.width || !this.width) return;
      this.scale = Math.min(box.width / this.width, box.height / this.height);
      this.ox = (box.width - this.width * this.scale) / 2;
      this.oy = (box.height - this.height * this.scale) / 2;
      this.fitted = true;
    },
    keepInside() {
      const box = this.box(), w = this.width * this.scale, h = this.height * this.scale;
      const clamp = (o, size, room) => size <= room ? (room - size) / 2 : Math.min(0, Math.max(room - size, o));
      this.ox = clamp(this.ox, w, box.width);
      this.oy = clamp(this.oy, h, box.height);
    },
    zoomAt(factor, x, y) {
      const box = this.box();
      const least = Math.min(box.width / this.width, box.height / this.height);
      const scale = Math.min(40, Math.max(least, this.scale * factor));
      this.ox = x - ((x - this.ox) * scale) / this.scale;
      this.oy = y - ((y - this.oy) * scale) / this.scale;
      this.scale = scale;
      this.fitted = scale <= least * 1.001;
      this.keepInside();
    },
    zoomBy(factor) {
      const box = this.box();
      const at = this.last || { x: box.width / 2, y: box.height / 2 };
      this.zoomAt(factor, at.x, at.y);
    },
    zoomTo(u, v, scale) {
      const box = this.box();
      this.scale = scale;
      this.fitted = false;
      this.ox = box.width / 2 - (u + 0.5) * scale;
      this.oy = box.height / 2 - (v + 0.5) * scale;
      this.keepInside();
    },
    wheel(e) {
      const box = this.box();
      this.zoomAt(Math.exp(-e.deltaY * 0.0016), e.clientX - box.left, e.clientY - box.top);
      this.hover(e);
    },
    place(e) {
      const box = this.box();
      return { x: e.clientX - box.left, y: e.clientY - box.top,
        u: (e.clientX - box.left - this.ox) / this.scale - 0.5, v: (e.clientY - box.top - this.oy) / this.scale - 0.5 };
    },
    inside(p) { return p.u >= -0.5 && p.v >= -0.5 && p.u <= this.width - 0.5 && p.v <= this.height - 0.5; },
    down(e) {
      this.pressed = { ...this.place(e), ox: this.ox, oy: this.oy, moved: false, button: e.button };
      this.$refs.root.setPointerCapture(e.pointerId);
    },
    move(e) {
      const at = this.place(e), from = this.pressed;
      if (from && (Math.abs(at.x - from.x) > 4 || Math.abs(at.y - from.y) > 4)) from.moved = true;
      if (from && from.moved) {
        this.ox = from.ox + at.x - from.x;
        this.oy = from.oy + at.y - from.y;
        this.fitted = false;
        this.keepInside();
      }
      this.hover(e);
    },
    up(e) {
      const from = this.pressed, at = this.place(e);
      this.pressed = null;
      document.activeElement && document.activeElement.blur && document.activeElement.blur();
      if (!from || from.moved || from.button !== 0 || !this.inside(at) || !this.current) return;
      this.$emit("pick", { u: at.u, v: at.v, zoom: this.scale, frame: Number(this.shown) });
    },
    leave() { this.pointer = ""; this.loupeOn = false; this.last = null; },
    hover(e) {
      const at = this.place(e);
      this.last = at;
      if (!this.inside(at) || !this.current) { this.pointer = ""; this.loupeOn = false; return; }
      this.pointer = `u ${at.u.toFixed(1)}   v ${at.v.toFixed(1)} px`;
      this.loupeOn = this.mode === "pick" && this.scale < 6;
      if (this.loupeOn) this.drawLoupe(at);
    },
    drawLoupe(at) {
      const canvas = this.$refs.loupe, c = canvas.getContext("2d"), n = 22, size = canvas.width, k = size / n;
      c.imageSmoothingEnabled = false;
      c.fillStyle = "#000";
      c.fillRect(0, 0, size, size);
      c.filter = this.lit ? "brightness(1.9) contrast(1.08)" : "none";
      if (this.picture) c.drawImage(this.picture, at.u + 0.5 - n / 2, at.v + 0.5 - n / 2, n, n, 0, 0, size, size);
      c.filter = "none";
      c.strokeStyle = "#fff"; c.lineWidth = 3; this.hair(c, size, k);
      c.strokeStyle = "#c4006a"; c.lineWidth = 1.2; this.hair(c, size, k);
    },
    hair(c, size, k) {
      const m = size / 2;
      c.beginPath();
      for (const [a, b] of [[0, m - k], [m + k, size]]) { c.moveTo(a, m); c.lineTo(b, m); c.moveTo(m, a); c.lineTo(m, b); }
      c.stroke();
    },
  },
};
