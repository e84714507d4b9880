// The twin from near: its mouth fills the picture. The choice is kept by the browser.

const KEPT = "lipservo-close-up";

class FaceCloseUp extends HTMLElement {
  connectedCallback() {
    this.innerHTML = '<label><input type="checkbox"> Close-up of the mouth</label>';
    const box = this.querySelector("input");
    box.checked = localStorage.getItem(KEPT) === "true";
    box.addEventListener("change", () => {
      localStorage.setItem(KEPT, String(box.checked));
      this.apply(box.checked);
    });
    this.apply(box.checked);
  }

  /** Once the twin is there, which is loaded after this. */
  async apply(isNear) {
    while (!window.twin) await new Promise((resolve) => setTimeout(resolve, 50));
    await window.twin.loaded;
    window.twin.closeUp(isNear);
    window.photograph?.view?.closeUp(isNear);
  }
}

customElements.define("face-close-up", FaceCloseUp);
