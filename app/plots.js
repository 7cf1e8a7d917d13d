// Curves over time, one above the other, with a line at the time of the frame that is shown; moving over them asks for a time.
export default {
  template: `
    <div class="plots" ref="root" @pointermove="move" @pointerdown="move" @pointerleave="hovering = false">
      <svg :width="w" :height="h" v-if="curves.panels">
        <g v-for="(p, i) in drawn" :key="i" :transform="'translate(0,' + i * ph + ')'">
          <text x="4" y="15" class="title">{{ p.label }} ({{ p.unit }})</text>
          <g v-for="t in p.ticks" :key="'y' + t.text">
            <line :x1="left" :x2="w - right" :y1="t.at" :y2="t.at" class="rule" />
            <text :x="left - 6" :y="t.at + 4.5" text-anchor="end" class="tick">{{ t.text }}</text>
          </g>
          <line v-for="t in xticks" :key="'x' + t.text" :x1="t.at" :x2="t.at" :y1="top" :y2="ph - bottom" class="rule" />
          <path :d="p.band" class="band" />
          <path :d="p.path" class="curve" />
          <rect :x="left" :y="top" :width="w - left - right" :height="ph - top - bottom" class="frame" />
          <circle v-if="p.dot" :cx="p.dot[0]" :cy="p.dot[1]" r="4.5" class="dot" />
        </g>
        <text v-for="t in xticks" :key="'n' + t.text" :x="t.at" :y="h - 6" text-anchor="middle" class="tick">{{ t.text }}</text>
        <text :x="w - right" :y="15" text-anchor="end" class="title">t (s)</text>
        <line v-if="time !== null && time >= t0 && time <= t1" :x1="x(time)" :x2="x(time)" :y1="top" :y2="h - foot" class="cursor" />
      </svg>
      <div v-else class="nothing">{{ empty }}</div>
    </div>`,
  props: { curves_json: String, empty: String },
  data() {
    return { curves: {}, time: null, w: 500, h: 300, left: 62, right: 12, top: 22, bottom: 8, foot: 22, hovering: false, sent: 0 };
  },
  computed: {
    n() { return this.curves.panels ? this.curves.panels.length : 1; },
    ph() { return (this.h - this.foot) / this.n; },
    t0() { return this.curves.t[0]; },
    t1() { return this.curves.t[this.curves.t.length - 1]; },
    xticks() { return this.steps(this.t0, this.t1, Math.max(3, this.w / 90)).map((v) => ({ at: this.x(v), text: this.text(v) })); },
    drawn() {
      return this.curves.panels.map((p) => {
        const good = p.y.filter((v) => v !== null);
        let low = Math.min(...good), high = Math.max(...good);
        const rim = 0.08 * (high - low || Math.abs(high) || 1);
        low -= rim; high += rim;
        const y = (v) => this.top + ((high - v) / (high - low)) * (this.ph - this.top - this.bottom);
        let path = "", band = "", open = false;
        p.y.forEach((v, k) => {
          if (v === null) { open = false; return; }
          path += (open ? "L" : "M") + this.x(this.curves.t[k]).toFixed(1) + "," + y(v).toFixed(1);
          open = true;
        });
        const rows = p.y.map((v, k) => [this.curves.t[k], v, p.sd[k]]).filter((r) => r[1] !== null && r[2] !== null);
        if (rows.length) {
          const side = (f, list) => list.map((r) => this.x(r[0]).toFixed(1) + "," + y(r[1] + f * r[2]).toFixed(1)).join("L");
          band = "M" + side(2, rows) + "L" + side(-2, [...rows].reverse()) + "Z";
        }
        let dot = null;
        if (this.time !== null) {
          const k = this.nearest(this.time);
          if (p.y[k] !== null && Math.abs(this.curves.t[k] - this.time) < 0.5) dot = [this.x(this.curves.t[k]), y(p.y[k])];
        }
        const ticks = this.steps(low, high, Math.max(3, this.ph / 22)).map((v) => ({ at: y(v), text: this.text(v) }));
        return { ...p, path, band, ticks, dot };
      });
    },
  },
  watch: { curves_json() { this.read(); } },
  mounted() {
    this.observer = new ResizeObserver(() => {
      const root = this.$refs.root;
      if (root.clientWidth) { this.w = root.clientWidth; this.h = root.clientHeight; }  // hidden it has none
    });
    this.observer.observe(this.$refs.root);
    this.read();
  },
  unmounted() { this.observer.disconnect(); },
  methods: {
    read() { this.curves = this.curves_json ? JSON.parse(this.curves_json) : {}; },
    at(t) { this.time = t; },
    x(t) { return this.left + ((t - this.t0) / (this.t1 - this.t0 || 1)) * (this.w - this.left - this.right); },
    nearest(t) {
      let a = 0, b = this.curves.t.length - 1;
      while (b - a > 1) { const m = (a + b) >> 1; if (this.curves.t[m] > t) b = m; else a = m; }
      return t - this.curves.t[a] < this.curves.t[b] - t ? a : b;
    },
    text(v) { return Math.abs(v) < 1e-9 ? "0" : Number(v.toPrecision(6)).toString(); },
    steps(low, high, most) {
      const raw = (high - low) / most, power = Math.pow(10, Math.floor(Math.log10(raw)));
      const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw);
      const found = [];
      for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) found.push(v);
      return found;
    },
    move(e) {
      if (!this.curves.panels) return;
      const box = this.$refs.root.getBoundingClientRect();
      const share = (e.clientX - box.left - this.left) / (this.w - this.left - this.right);
      if (share < 0 || share > 1) return;
      const t = this.t0 + share * (this.t1 - this.t0);
      this.time = t;
      const now = performance.now();
      clearTimeout(this.later);
      const send = () => { this.sent = performance.now(); this.$emit("seek", { t }); };
      if (now - this.sent > 40) send(); else this.later = setTimeout(send, 45);
    },
  },
};
