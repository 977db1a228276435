() => {
  // Every visible piece of text with its contrast (WCAG 2.2, 1.4.3) against the nearest grounds behind it.
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true })
  const rgba = (css) => {
    canvas.clearRect(0, 0, 1, 1)
    canvas.fillStyle = css
    canvas.fillRect(0, 0, 1, 1)
    const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data
    return [r, g, b, a / 255]
  }
  const over = (top, ground) => top.slice(0, 3).map((value, k) => value * top[3] + ground[k] * (1 - top[3]))
  const luminance = (colour) => {
    const [r, g, b] = colour.map((v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b
  }
  const behind = (element) => {
    const grounds = []
    for (let at = element; at; at = at.parentElement ?? at.getRootNode().host) {
      grounds.push(rgba(getComputedStyle(at).backgroundColor))
      if (grounds.at(-1)[3] === 1) break
    }
    return grounds.reverse().reduce((ground, top) => over(top, ground), [255, 255, 255])
  }
  const found = []
  const look = (root) => {
    const walker = document.createTreeWalker(root, NodeFilter.SHOW_ELEMENT)
    for (let element = walker.nextNode(); element; element = walker.nextNode()) {
      if (element.shadowRoot) look(element.shadowRoot)
      // An icon is a drawing, though its font spells it as a word.
      if (element.closest("svg, canvas, [disabled], [aria-disabled=true], [data-testid=stIconMaterial]")) continue
      if (!element.checkVisibility()) continue
      const text = [...element.childNodes].filter((n) => n.nodeType === 3).map((n) => n.data.trim()).join(" ").trim()
      const style = getComputedStyle(element)
      const box = element.getBoundingClientRect()
      if (!text || style.visibility === "hidden" || box.width < 2 || box.height < 2) continue
      let opacity = 1
      for (let at = element; at; at = at.parentElement) opacity *= Number(getComputedStyle(at).opacity)
      if (opacity === 0) continue
      const ground = behind(element)
      const [r, g, b, a] = rgba(style.color)
      const [light, dark] = [luminance(over([r, g, b, a * opacity], ground)), luminance(ground)].sort((x, y) => y - x)
      const size = parseFloat(style.fontSize)
      const least = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700) ? 3 : 4.5
      const ratio = (light + 0.05) / (dark + 0.05)
      if (ratio < least) found.push(`${text.slice(0, 40)} (${ratio.toFixed(2)}, ${style.color} on ${ground.map(Math.round)})`)
    }
  }
  look(document.body)
  return found
}
