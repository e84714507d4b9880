// The NiceGUI element: a box with a head in it. It decodes nothing: see window.twin.apply.

import { pictureOf } from "lipservo-twin";

export default {
  template: `
    <div style="position:relative;overflow:hidden">
      <div ref="place" style="position:absolute;inset:0"></div>
      <div v-if="said" style="position:absolute;inset:0;display:grid;place-content:center">{{ said }}</div>
    </div>`,
  props: { source: String },
  data: () => ({ said: "Loading the face ..." }),
  /** Show the picture, as `window.twin`, and say in its place if the head cannot be loaded. */
  async mounted() {
    this.picture = pictureOf(this.source);
    this.picture.placeIn(this.$refs.place);
    window.twin = this.picture;
    try {
      await this.picture.loaded;
      this.said = "";
    } catch (error) {
      this.said = `The face could not be loaded (${error.message}). Reload the page.`;
    }
  },
  beforeUnmount() {
    this.picture.stop();
    if (window.twin === this.picture) delete window.twin;
  },
};
